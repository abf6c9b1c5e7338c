"""A stand-in for an installed Blender: uses the worker's protocol, writes a flat picture, and misbehaves on demand."""

import json
import os
import random
import signal
import struct
import sys
import time
import zlib
from pathlib import Path

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


def main():
    print("Blender 5.0.1 (a fake)")
    answer({"ready": "fake"})
    for line in sys.stdin:
        job = json.loads(line)
        if job["do"] == "start":
            answer({"done": "start", "device": "CPU", "devices": 1})
            continue
        # "crash:2" crashes in the first two attempts, which are counted by files in a folder.
        how, _, times = job.get("how", "").partition(":")
        if how and times:
            attempt = Path(job["memory"]) / f"{job['name']}-{len(os.listdir(job['memory']))}"
            if sum(f.startswith(f"{job['name']}-") for f in os.listdir(job["memory"])) < int(times):
                attempt.touch()
            else:
                how = ""
        message = misbehave(how)
        if message is None and job["do"] == "render" and job["camera"]["intrinsics"]["width"] == TOO_WIDE:
            message = {"failed": "MemoryError: "}
        if message is None and job["do"] == "render":
            time.sleep(random.uniform(0.0, 0.01))
            size = job["camera"]["intrinsics"]
            Path(job["output"]).write_bytes(png(size["width"], size["height"], job["seed"] % 256))
        answer(message or {"done": job["do"], "pid": os.getpid(), "name": job.get("name")})


main()
