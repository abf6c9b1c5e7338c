"""A stand-in for an installed Blender: uses the worker's protocol, writes a flat picture, and misbehaves on demand."""

import contextlib
import importlib.util
import json
import os
import pickle
import random
import signal
import struct
import sys
import time
import zlib
from pathlib import Path
from types import SimpleNamespace

ANSWER = "@hulldown "
TOO_WIDE = 65536  # pixels


def answer(message):
    sys.stdout.write(ANSWER + json.dumps(message) + "\n")
    sys.stdout.flush()


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
        return {"failed": "ValueError: as asked"}
    if how == "crash":
        print("Segmentation fault, as asked", file=sys.stderr, flush=True)
        os.kill(os.getpid(), signal.SIGSEGV)
    if how == "exit":
        sys.exit(3)
    if how == "hang":
        time.sleep(600)
    if how == "grow":
        held.append(touched(300 << 20))
        time.sleep(600)
    return None


class Camera:
    """The size of a picture, as a stand-in for `Intrinsics`, which needs numpy."""

    def __setstate__(self, values):
        self.width, self.height, *_ = values


def messages():
    """The module `render.messages`, without the packages that it imports."""
    for name in ("hulldown", *(f"hulldown.camera.{name}" for name in ("intrinsics", "sensor", "weather.kinds"))):
        sys.modules[name] = SimpleNamespace(Intrinsics=Camera, Sensor=object, Weather=object)
    path = Path(__file__).parents[1] / "render" / "messages.py"
    spec = importlib.util.spec_from_file_location("hulldown.render.messages", path)
    sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main():
    print("Blender 5.0.1 (a fake)")
    kinds = messages()
    answer({"ready": "fake"})
    while True:
        job = pickle.load(sys.stdin.buffer)
        if isinstance(job, kinds.StartJob):
            answer({"device": "CPU", "devices": 1})
            continue
        # "crash:2" crashes in the first two attempts, which are counted by files beside the output.
        how, _, times = Path(job.scenery.path).name.partition(":")
        output = Path(job.output)
        if times and len(attempts := list(output.parent.glob(f"{output.stem}-*"))) < int(times):
            output.with_name(f"{output.stem}-{len(attempts)}").touch()
        elif times:
            how = ""
        message = misbehave(how)
        if message is None and job.camera.intrinsics.width == TOO_WIDE:
            message = {"failed": "MemoryError: "}
        if message is None:
            time.sleep(random.uniform(0.0, 0.01))
            size = job.camera.intrinsics
            output.write_bytes(png(size.width, size.height, getattr(job, "seed", 0) % 256))
        answer(message or {"pid": os.getpid()})


with contextlib.suppress(EOFError):
    main()
