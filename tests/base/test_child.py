"""Child processes: their output is heard, and they end in time."""

import os
import queue
import signal
import subprocess
import sys
import time

import psutil
import pytest

from hulldown.base.child import Child

ECHO = "import sys\nfor line in sys.stdin: print(line.strip()[::-1], flush=True)"
WATCH = "import time; from hulldown.base.child import end_with_parent; end_with_parent(9); time.sleep(600)"
SLEEP = "import time; print('here', flush=True); time.sleep(600)"


def started(code, heard, **options):
    return Child([sys.executable, "-I", "-c", code], env=os.environ, on_line=heard.put, **options)


@pytest.fixture
def heard():
    return queue.SimpleQueue()


def test_it_gets_lines_and_answers_and_ends_with_its_stdin(heard):
    with started(ECHO, heard) as child:
        child.write(b"abc\n")
        assert heard.get(timeout=60) == b"cba\n"
        child.close_stdin()
        assert child.wait(60) == child.code == 0
        assert heard.get(timeout=60) == b""


def test_leaving_the_context_kills_it(heard):
    with started(SLEEP, heard) as child:
        assert heard.get(timeout=60) == b"here\n"
        assert child.wait(0.01) is child.code is None
        assert child.memory > 2**20
    assert child.code == -signal.SIGKILL
    assert child.memory == 0


def test_last_words_belong_to_this_process(heard, tmp_path):
    (tmp_path / "log").write_text("of another\n")
    for code, words in (("import sys; sys.exit('no disk')", "no disk"), ("import sys; sys.exit(3)", "")):
        with started(code, heard, log=tmp_path / "log") as child:
            child.wait()
            how = f"ended with exit code {1 if words else 3}"
            assert child.describe_end() == (f"{how}; its last words: {words}" if words else how)


def test_a_surviving_grandchild_does_not_block(heard):
    """It holds the other end of stdout."""
    code = "import subprocess, sys; print(subprocess.Popen(['sleep', '600']).pid, flush=True); sys.stdin.read()"
    with started(code, heard) as child:
        grandchild = int(heard.get(timeout=60))
    assert child.code == -signal.SIGKILL
    os.kill(grandchild, signal.SIGKILL)


@pytest.mark.parametrize("child", [ECHO, WATCH])
def test_it_notices_the_end_of_its_parent(child):
    code = (
        "import os, sys; from hulldown.base.child import Child;"
        f"child = Child([sys.executable, '-P', '-c', {child!r}], env=os.environ, on_line=print);"
        "print(child.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    pid = int(ran.stdout.split()[0])
    end = time.monotonic() + 60
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < end
        time.sleep(0.05)
