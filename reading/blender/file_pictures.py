"""Compare what was read of a file, except hair, with what Cycles draws, by pictures of objects and depths."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from jaxtyping import Bool, Float, Int
from PIL import Image
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation

from hulldown.blender.add_nodes import add_node
from hulldown.blender.frames import world_from_blender_camera
from hulldown.blender.light_pictures import render_light, set_light_at_pixel_centers
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.naming import first_matching_pattern
from hulldown.reading.pieces.roles import Evaluated, Unseen
from hulldown.reading.pieces.wording import quote_names
from hulldown.scene.instances import InstancedScene
from hulldown.scene.rays import RayList

VIEW_SIDE_PX = 128
VIEW_WIDTH_DIAGONALS = 1.2  # of what was read
EYE_HEIGHT_SHARE = 0.01  # of that diagonal: the camera's height above the surface in the middle of a scenery
DEPTH_TOLERANCE_DIAGONALS = 2e-3
MAX_STEP_PX = 0.1  # of float32 coordinates; with larger steps, as on maps, Cycles' picture of the file isn't reliable
MIN_DIFFERENT_SHARE = 0.003  # of the pixels that show anything; less is rounding
MAX_DIFFERENT_SHARE = 0.03  # with more, the file wasn't read
MIN_OBJECT_PX = 8  # for an object that is lost as a whole
MAX_PASS_INDEX = 32767  # Blender's limit
NOT_CAST = (Unseen.RAY_VISIBILITY, Unseen.INDIRECT_ONLY)  # Cycles' camera rays pass through these
SIGHTS = {"vehicle": ((-1.0, -0.7, -0.5), (0.8, 1.0, -0.45), (-0.1, 0.15, -1.0)), "scenery": ((-0.1, 0.15, -1.0),)}
GRAYS_AND_MARKS = np.array([(250, 250, 250), (120, 120, 120), (213, 94, 0), (0, 114, 178)], np.uint8)


@dataclass(frozen=True, eq=False, slots=True)
class _View:
    """A camera in the world of the file, and the width of its picture; 0 for one that looks around, 90 degrees wide."""

    world_from_camera: Float[np.ndarray, "4 4"]
    width: float

    def rays(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Return origin and direction of each pixel; distances along them, times the direction, are depths."""
        across = (np.arange(VIEW_SIDE_PX) + 0.5) / VIEW_SIDE_PX - 0.5
        x, y = (plane.ravel() for plane in np.meshgrid(across, across))
        plane = np.stack([x, y, np.zeros(len(x))], axis=1)
        sight = np.array([0.0, 0.0, 1.0]) + (0.0 if self.width else 2.0) * plane
        axes, at = self.world_from_camera[:3, :3], self.world_from_camera[:3, 3]
        return at + self.width * plane @ axes.T, sight @ axes.T


def lost_geometry_doubts(
    drawn: Evaluated, *, up: Float[np.ndarray, "3"], kind: str, absent: Container[str], drop: Sequence[str], picture: Path
) -> list[Doubt]:
    """Return a doubt about geometry of the open file that Cycles draws and that wasn't read, or the other way round.

    `up`: in the world of the file. `absent`: names of pieces that were taken out of the open file. `drop`: the config's
    patterns. `picture`: written if there is a doubt; for each view, the file over what was read, what is lost in orange
    and what is new in blue.
    """
    pieces = [p for p in drawn.pieces if p.unseen not in NOT_CAST and p.name not in absent]
    meshes = [replace(mesh, cutouts=None) for mesh in drawn.meshes]
    read = InstancedScene(meshes, [p.mesh for p in pieces], np.array([p.pose for p in pieces]).reshape(-1, 4, 4))
    diagonal = float(np.linalg.norm(np.ptp(read.bounds, axis=(0, 1)))) if pieces else 0.0
    if not pieces or np.spacing(np.float32(np.abs(read.bounds).max())) > MAX_STEP_PX * diagonal / VIEW_SIDE_PX:
        return []
    names = [obj.name for obj in bpy.data.objects]
    fuzzy = np.array([p.hair or p.unseen is not None or p.chain[0].kind == "POINTCLOUD" for p in pieces] + [False])
    varying = np.array([name in drawn.varying or bool(first_matching_pattern(name, drop)) for name in names] + [False])
    pixels, added, shown = np.zeros((2, len(varying)), int), list[int](), list[np.ndarray]()
    scene = bpy.context.scene
    _prepare_number_render(scene)
    for view in _scene_views(read, up, kind):
        depth, number, strand = _render_depth_number_and_hair(scene, view, diagonal)
        number = np.where(np.isfinite(depth), np.minimum(number, len(names) - 1), len(names))
        cast, piece = _cast_depths_and_pieces(read, view)
        skipped = binary_dilation(strand | fuzzy[piece] | varying[number], np.ones((3, 3)))
        near = DEPTH_TOLERANCE_DIAGONALS * diagonal
        differs = _depth_difference_mask(depth, cast, near) & _depth_difference_mask(cast, depth, near) & ~skipped
        gone = differs & (depth < cast)
        pixels += [np.bincount(number[mask], minlength=len(varying)) for mask in (~skipped, gone)]
        added += piece[differs & ~gone].tolist()
        state = np.where(gone, 2, np.where(differs, 3, 0))
        shown.append(np.concatenate([np.where(differs, state, np.isfinite(each)) for each in (depth, cast)]).astype(int))
    covered = max(int(sum((tile > 0).sum() for tile in shown)) / 2.0, 1.0)
    whole = [names[i] for i in range(len(names)) if pixels[1, i] >= MIN_OBJECT_PX and 2 * pixels[1, i] > pixels[0, i]]
    gone, new = pixels[1].sum() / covered, len(added) / covered
    if not whole and gone + new < MIN_DIFFERENT_SHARE:
        return []
    Image.fromarray(GRAYS_AND_MARKS[np.concatenate(shown, axis=1)]).save(picture)
    worst = whole or [names[i] for i in np.argsort(-pixels[1, :-1], kind="stable") if pixels[1, i]]
    if gone >= new:
        text = f"Blender draws {quote_names(worst)} where nothing was read"
        text += f" ({100 * gone:.1f} % of its pictures); apply its modifiers in Blender, or name it in `drop`"
    else:
        extra = dict.fromkeys(pieces[i].name for i in sorted(added, key=added.count, reverse=True) if i >= 0)
        text = f"{quote_names(extra)} is read where Blender draws nothing ({100 * new:.1f} % of its pictures)"
    is_lost = bool(whole) or gone + new > MAX_DIFFERENT_SHARE
    return [Doubt(DoubtKind.LOST if is_lost else DoubtKind.NOT_READ, text)]


def _scene_views(read: InstancedScene, up: Float[np.ndarray, "3"], kind: str) -> Iterator[_View]:
    low, high = read.bounds[:, 0].min(axis=0), read.bounds[:, 1].max(axis=0)
    middle, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    upright = Rotation.align_vectors([up], [[0.0, 0.0, 1.0]])[0]
    for sight in SIGHTS[kind]:
        ahead = upright.apply(np.array(sight) / np.linalg.norm(sight))
        yield _View(_pose_looking_ahead(middle - diagonal * ahead, ahead, up), VIEW_WIDTH_DIAGONALS * diagonal)
    if kind == "scenery":
        top = middle + diagonal * up + diagonal * np.array([1e-4, 2e-4, 3e-4])  # beside edges of grids
        down = float(read.first_hits(RayList(top[None], -up[None])).distance[0])
        ahead = upright.apply(np.array([0.8, 0.6, 0.0]))
        yield _View(_pose_looking_ahead(top - (min(down, diagonal) - EYE_HEIGHT_SHARE * diagonal) * up, ahead, up), 0.0)


def _pose_looking_ahead(
    at: Float[np.ndarray, "3"], ahead: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    pose, right = np.eye(4), np.cross(ahead, up)
    right /= np.linalg.norm(right)
    pose[:3] = np.stack([right, np.cross(ahead, right), ahead, at], axis=1)
    return pose


def _prepare_number_render(scene: Any) -> None:
    bpy.data.objects.foreach_set("pass_index", np.minimum(np.arange(len(bpy.data.objects)), MAX_PASS_INDEX))
    material = bpy.data.materials.new("hulldown numbers")
    material.cycles.emission_sampling = "NONE"
    tree = material.node_tree
    tree.nodes.clear()
    number, depth = (add_node(tree, "ObjectInfo").outputs["Object Index"], add_node(tree, "CameraData").outputs["View Z Depth"])
    values = add_node(tree, "CombineXYZ", {0: number, 1: depth, 2: add_node(tree, "HairInfo").outputs["Is Strand"]})
    emission = add_node(tree, "Emission", {"Color": values.outputs[0]})
    add_node(tree, "OutputMaterial", {"Surface": emission.outputs[0]})
    for layer in scene.view_layers:
        layer.material_override, layer.samples = material, 0
    cycles, render = scene.cycles, scene.render
    scene.world, render.engine, cycles.device = None, "CYCLES", "CPU"
    render.use_persistent_data = render.film_transparent = True
    render.use_motion_blur = render.use_border = cycles.use_camera_cull = cycles.use_distance_cull = False
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.shading_system = False
    cycles.samples, cycles.film_exposure, cycles.sample_clamp_direct, cycles.max_bounces = 1, 1.0, 0.0, 0
    render.threads_mode, render.threads, render.pixel_aspect_x, render.pixel_aspect_y = "FIXED", 2, 1.0, 1.0
    render.resolution_x = render.resolution_y = VIEW_SIDE_PX
    render.resolution_percentage = 100
    set_light_at_pixel_centers(scene)
    render.image_settings.color_mode = "RGBA"


def _render_depth_number_and_hair(
    scene: Any, view: _View, diagonal: float
) -> tuple[Float[np.ndarray, "h w"], Int[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return depth (inf: nothing), number of the object, and whether it's hair, of each pixel of the open file."""
    camera = scene.camera
    camera.matrix_world = world_from_blender_camera(view.world_from_camera).T.tolist()
    camera.data.type, camera.data.ortho_scale = "ORTHO" if view.width else "PERSP", view.width or 1.0
    camera.data.angle, camera.data.clip_start, camera.data.clip_end = np.pi / 2, 1e-4 * diagonal, 10.0 * diagonal
    number, depth, strand, alpha = np.moveaxis(render_light(scene)[::-1], 2, 0)
    drawn = alpha > 0.5
    return np.where(drawn, depth, np.inf), np.rint(number).astype(int), drawn & (strand > 0.5)


def _cast_depths_and_pieces(read: InstancedScene, view: _View) -> tuple[Float[np.ndarray, "h w"], Int[np.ndarray, "h w"]]:
    """Return depth and number (-1: none) of the piece that each pixel of a view shows."""
    origins, along = view.rays()
    hits = read.first_hits(RayList(origins, along))
    depth = hits.distance / np.linalg.norm(along, axis=1)
    return depth.reshape(VIEW_SIDE_PX, VIEW_SIDE_PX), hits.instance.reshape(VIEW_SIDE_PX, VIEW_SIDE_PX)


def _depth_difference_mask(
    depth: Float[np.ndarray, "h w"], other: Float[np.ndarray, "h w"], near: float
) -> Bool[np.ndarray, "h w"]:
    """Return where a depth isn't among those of another picture at the same pixel or beside it."""
    return (depth < minimum_filter(other, 3) - near) | (depth > maximum_filter(other, 3) + near)
