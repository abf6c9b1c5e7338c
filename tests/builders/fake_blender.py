"""A stand-in for an installed Blender: the worker around a renderer that writes flat pictures and fails on demand."""

import os
import random
import runpy
import signal
import struct
import sys
import time
import zlib
from pathlib import Path
from types import SimpleNamespace

TOO_WIDE = 65536  # pixels


def png(width, height, level):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = (b"\0" + bytes([level]) * width) * height
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


held = []


def touched(size):
    memory = bytearray(size)
    memory[::4096] = b"x" * len(memory[::4096])
    return memory


def misbehave(how):
    if how == "hold":
        held.append(touched(105 << 20))
    if how == "fail":
        raise ValueError("as asked")
    if how == "crash":
        print("Segmentation fault, as asked", file=sys.stderr, flush=True)
        os.kill(os.getpid(), signal.SIGSEGV)
    if how == "exit":
        os._exit(3)
    if how == "hang":
        time.sleep(600)
    if how == "grow":
        held.append(touched(300 << 20))
        time.sleep(600)


class Renderer:
    """Does jobs; the name of a job's scenery, or FAILS in the environment, tells how it fails."""

    def do(self, job):
        from hulldown.render.blender.reply import Reply  # the worker has made it importable

        if type(job).__name__ == "StartJob":
            return Reply(device="CPU")
        # "crash:2" crashes in the first two attempts, which are counted by files beside the output.
        how, _, times = os.environ.get("FAILS", Path(job.scenery).name).partition(":")
        output = Path(job.output)
        attempts = list(output.parent.glob(f"{output.stem}-*"))
        if not times or len(attempts) < int(times):
            output.with_name(f"{output.stem}-{len(attempts)}").touch()
            misbehave(how)
        size = job.camera.intrinsics
        if size.width == TOO_WIDE:
            raise MemoryError
        time.sleep(random.uniform(0.0, 0.01))
        picture = png(size.width, size.height, job.seed % 256)
        output.write_bytes(picture[:-20] if how == "cut" else picture)
        output.with_suffix(".pid").write_text(str(os.getpid()))
        return Reply()

    def forget_assets(self):
        pass


class Unusable(Exception):
    pass


print("Blender 5.0.1 (a fake)")
sys.modules["bpy"] = SimpleNamespace(app=SimpleNamespace(version=(5, 0, 1), version_string="fake"))
sys.modules["hulldown.render.blender.cycles"] = SimpleNamespace(Unusable=Unusable)
sys.modules["hulldown.render.blender.renderer"] = SimpleNamespace(Renderer=Renderer)
runpy.run_path(str(Path(__file__).parents[2] / "render" / "blender" / "worker.py"), run_name="__main__")
