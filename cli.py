"""The `hulldown` command: its verbs, errors, and exit codes; no logic.

Messages and progress go to stderr, results to stdout, so that `--json` can be piped. Exit code 0: done; 1: done, but
something failed or was found; 2: a user's mistake, explained in one line; 130: stopped by Ctrl-C, or `render` by
SIGTERM.
"""

from __future__ import annotations

import errno
import io
import sys
from collections.abc import Sequence

from cyclopts.exceptions import CycloptsError
from rich.markup import escape

from hulldown.base.errors import HulldownError, shorten_text
from hulldown.base.terminal import STDERR_TERMINAL
from hulldown.verbs import demo, planning, rendering, training
from hulldown.verbs.command import describe_parser_error, find_verb_name, run_command
from hulldown.verbs.output import DONE, MISTAKE, STDOUT_NAME, STOPPED, show_one_line_warnings, silence_stdout

MAX_LINE_CHARACTERS = 2000
# Errors of the file system that aren't bugs: a full disk, missing rights, a file instead of a folder or the reverse.
REFUSED_ERRNOS = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "make room and run the same command again"),
    **dict.fromkeys((errno.EROFS, errno.EACCES, errno.EPERM), "name another place, or give yourself the right to it"),
    **dict.fromkeys((errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP), "name another file or folder"),
}
CHANGED_FILE_ERRNOS = (errno.ENOENT, errno.EINVAL, errno.ESTALE)  # a named file is gone, or another than before
VERBS = planning.VERBS | rendering.VERBS | training.VERBS | demo.VERBS


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # an ASCII terminal must not fail a finished run
            stream.reconfigure(errors="backslashreplace")
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        with show_one_line_warnings():
            return run_command(words, VERBS)
    except HulldownError as error:
        return _print_refusal(str(error))
    except CycloptsError as error:
        asked = " ".join(["hulldown", find_verb_name(words, VERBS) or "", "--help"])
        return _print_refusal(f"{describe_parser_error(error)} (see `{' '.join(asked.split())}`)")
    except KeyboardInterrupt:
        resumes = any(verb.resumes for name, verb in VERBS.items() if words[: name.count(" ") + 1] == name.split())
        return _print_refusal(f"stopped; {'the same command goes on from here' if resumes else 'nothing was written'}", STOPPED)
    except BrokenPipeError:
        # The reader of stdout is gone, as with `head`.
        silence_stdout()
        return DONE
    except OSError as error:
        if error.errno not in REFUSED_ERRNOS and not (error.errno in CHANGED_FILE_ERRNOS and error.filename):
            raise
        if error.filename == STDOUT_NAME:
            silence_stdout()
        remedy = REFUSED_ERRNOS.get(error.errno or 0, "run the same command again")
        return _print_refusal(f"{error.filename or 'a file cannot be written'}: {error.strerror}; {remedy}")


def _print_refusal(problem: str, code: int = MISTAKE) -> int:
    STDERR_TERMINAL.print(f"hulldown: {escape(shorten_text(problem, MAX_LINE_CHARACTERS))}", soft_wrap=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
