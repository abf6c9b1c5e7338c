"""What the client of a cluster and its nodes tell one another: plain data, checked against its schema on arrival."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import math
import os
from functools import cache
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from assets.bundle import FORMAT
from reading.cache import EXPORTER
from render.messages import RenderJob, SceneryInput

Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
Device = Annotated[str, Meta(pattern="^(auto|cpu|gpu|optix|cuda|hip|oneapi|metal)$")]
LARGEST = 65536  # pixels of a side, as in `planning.row`
PIECE = 1 << 22  # bytes of a file that are sent at a time


class Versions(Struct, frozen=True):
    """What client and node must have in common, so that both mean the same picture.

    Parameters
    ----------
    hulldown
        Its version, and the beginning of the SHA-256 of the code that renders.
    bpy
        The version of the Blender module; empty if there is none.
    cache
        Of the files that reading an asset leaves behind.
    """

    hulldown: str
    bpy: str
    cache: str

    def difference(self, client: Versions) -> str:
        """Why a node of these versions cannot render for a client of others; empty if it can."""
        if not self.bpy:
            return "has no bpy"
        pairs = ((name, getattr(self, name), getattr(client, name)) for name in ("hulldown", "bpy", "cache"))
        # A client that plans and renders nothing itself may have no bpy.
        wrong = next(((name, mine, other) for name, mine, other in pairs if mine != other and other), None)
        return f"has {wrong[0]} {wrong[1]}, and the client {wrong[2]}" if wrong else ""


@cache
def versions() -> Versions:
    """What this process runs."""
    root = Path(__file__).resolve().parents[1]
    code = hashlib.sha256()
    for path in sorted([*(root / "render").rglob("*.py"), *(root / "reading" / "blender").rglob("*.py")]):
        code.update(path.read_bytes())
    try:
        bpy = importlib.metadata.version("bpy")
    except importlib.metadata.PackageNotFoundError:
        bpy = ""
    hulldown = f"{importlib.metadata.version('hulldown')} ({code.hexdigest()[:8]})"
    return Versions(hulldown, bpy, f"{EXPORTER}.{FORMAT}")


class FileNote(Struct, frozen=True):
    """A file by its place on the client's disk, its content and its bytes."""

    path: str
    sha256: Sha256
    size: Annotated[int, Meta(ge=0)]


class AssetNote(Struct, frozen=True):
    """A file that jobs name, and those that it refers to itself: textures and libraries."""

    file: FileNote
    references: list[FileNote] = []

    @property
    def files(self) -> list[FileNote]:
        """All of them."""
        return [self.file, *self.references]


class Order(Struct, frozen=True):
    """A picture to be rendered: its row's index in the plan, and what to tell Blender."""

    index: Annotated[int, Meta(ge=0)]
    job: RenderJob


class Parcel(Struct, frozen=True):
    """Neighbouring rows for a node.

    Parameters
    ----------
    orders
        The pictures.
    assets
        Every file that they name.
    device
        What `render.blender.cycles.choose_device` takes.
    image_s
        Seconds that a picture gets; None for what the first ones teach.
    shared
        Folder in the dataset to render into, which the node must see too; empty if pictures are sent back.
    """

    orders: list[Order]
    assets: list[AssetNote]
    device: Device
    image_s: Annotated[float, Meta(gt=0)] | None = None
    shared: str = ""


class _Sent(Struct, frozen=True):
    """A parcel on its way. Its jobs do not name the objects of their sceneries: `which` says whose names each needs.

    Those names are nearly all of a job, and its neighbours have the same.
    """

    parcel: Parcel
    sceneries: list[SceneryInput]
    which: list[Annotated[int, Meta(ge=0)]]


class Picture(Struct, frozen=True):
    """A finished picture: its row, its PNG file unless that was left in the shared folder, and what rendered it."""

    index: int
    png: bytes
    device: str


class Failure(Struct, frozen=True):
    """A row that a node has given up, and the reason of each attempt."""

    index: int
    reasons: list[str]


class Answer(Struct, frozen=True):
    """What becomes of a parcel.

    Parameters
    ----------
    refused
        Why the node cannot render at all; empty if it can.
    lacking
        Files that the node must be sent before it can begin, by their SHA-256.
    pictures, failures
        Each row of the parcel in one of them, unless it was refused or something is lacking.
    folder
        Name of the node's folder in the shared one, in which its pictures are.
    lines
        What a user may want to know.
    restarts
        How often Blender had to be started again.
    seconds
        How long it took.
    blender, system
        What it was rendered with.
    """

    refused: str = ""
    lacking: list[Sha256] = []
    pictures: list[Picture] = []
    failures: list[Failure] = []
    folder: Annotated[str, Meta(pattern="^[0-9a-f]*$")] = ""
    lines: list[str] = []
    restarts: int = 0
    seconds: float = 0.0
    blender: str = ""
    system: str = ""


class Piece(Struct, frozen=True):
    """A part of a file that a node lacks; with the last it is whole, and held against its SHA-256."""

    sha256: Sha256
    offset: Annotated[int, Meta(ge=0)]
    size: Annotated[int, Meta(ge=0)]
    content: bytes


encode = msgspec.msgpack.Encoder().encode
decode_versions = msgspec.msgpack.Decoder(Versions).decode
decode_answer = msgspec.msgpack.Decoder(Answer).decode
decode_piece = msgspec.msgpack.Decoder(Piece).decode
_sent = msgspec.msgpack.Decoder(_Sent).decode


def encode_parcel(parcel: Parcel) -> bytes:
    """A parcel to be sent, for `decode_parcel`."""
    sceneries: list[SceneryInput] = []
    which, orders = [], []
    for order in parcel.orders:
        scenery = order.job.scenery
        if scenery not in sceneries:
            sceneries.append(scenery)
        which.append(sceneries.index(scenery))
        bare = dataclasses.replace(scenery, standing=[], removed=[])
        orders.append(Order(order.index, dataclasses.replace(order.job, scenery=bare)))
    return encode(_Sent(msgspec.structs.replace(parcel, orders=orders), sceneries, which))


def decode_parcel(data: bytes) -> Parcel:
    """A parcel that was sent.

    Raises
    ------
    ValueError
        If it is none, or has matrices, sizes or numbers that no plan could have.
    """
    sent = _sent(data)
    if len(sent.which) != len(sent.parcel.orders) or max(sent.which, default=-1) >= len(sent.sceneries):
        raise ValueError(f"expected a scenery for each of {len(sent.parcel.orders)} images")
    orders = [
        Order(order.index, dataclasses.replace(order.job, scenery=sent.sceneries[i]))
        for order, i in zip(sent.parcel.orders, sent.which, strict=True)
    ]
    parcel = msgspec.structs.replace(sent.parcel, orders=orders)
    for note in parcel.assets:
        for file in note.files:
            # Nodes lay files out below a folder of theirs.
            if not (file.path.startswith("/") and "\0" not in file.path and file.path == _normal(file.path)):
                raise ValueError(f"expected an absolute path without detours, got {file.path!r}")
    known = {note.file.path for note in parcel.assets}
    for order in parcel.orders:
        job = order.job
        if not all(1 <= side <= LARGEST for side in (job.camera.width, job.camera.height)):
            raise ValueError(f"image {order.index}: expected sides from 1 to {LARGEST} pixels")
        matrices = [job.scenery.scenery_from_file, job.camera.world_from_camera]
        matrices += [matrix for vehicle in job.vehicles for matrix in vehicle.world_from_parts]
        if not all(len(matrix) == 4 and all(len(row) == 4 for row in matrix) for matrix in matrices):
            raise ValueError(f"image {order.index}: expected poses of (4, 4)")
        light, camera = job.light, job.camera
        numbers = [x for matrix in matrices for row in matrix for x in row]
        numbers += [light.yaw, light.strength, light.horizon or 0.0]
        numbers += [camera.fov_x, camera.near, camera.exposure, camera.white_balance]
        if air := job.weather:
            numbers += [air.visibility_m, air.rain_mm_h, *air.wind_m_s, air.exposure_s, air.ground_cover]
            numbers.append(air.vehicle_cover)
        coats = [paint for vehicle in job.vehicles for paint in vehicle.paint]
        numbers += [x for p in coats for x in (p.mean, *(p.colour or ()), p.hue, p.saturation, p.value)]
        if not all(map(math.isfinite, numbers)):
            raise ValueError(f"image {order.index}: expected finite numbers")
        if unknown := named_files(job) - known:
            raise ValueError(f"image {order.index}: {min(unknown)!r} is not among its files")
    return parcel


def _normal(path: str) -> str:
    return "/" + os.path.normpath(path).lstrip("/")


def named_files(job: RenderJob) -> set[str]:
    """The paths that a job names."""
    return {job.scenery.path, job.light.hdri, *(vehicle.tidy for vehicle in job.vehicles)}
