from fractions import Fraction

import numpy as np
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hulldown.geometry.boxtree import BoxTree
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.geometry.transforms import invert_rigid, rigid_matrix, transform_points
from hulldown.scene.instances import InstancedScene
from hulldown.scene.obstacles import box_pair_touch_mask, triangle_box_touch_mask
from hulldown.scene.ray_caster import RayCaster
from hulldown.scene.rays import RayList
from hulldown.tests.builders.shapes import CORNERS, QUADS, random_rotations
from hulldown.tests.oracles.clipping import clipped

# float32 around the center of a scene some 20 m wide, seen at grazing angles.
CLOSE = 2e-4


def soup(rng, faces):
    corners = rng.normal(0, 0.6, (faces, 1, 3)) + rng.normal(0, 0.3, (faces, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * faces).reshape(-1, 3), "soup")


def scene_and_flat(seed, k, squashed, offset=0.0):
    rng = np.random.default_rng(seed)
    meshes = [soup(rng, 12), soup(rng, 1), soup(rng, 40)]
    poses = np.tile(np.eye(4), (k, 1, 1))
    # Sheared, but no flatter than a twentieth: float32 loses as many digits as a pose is flat.
    poses[:, :3, :3] = random_rotations(rng, k) * rng.uniform(0.05, 2.0, (k, 1, 3)) @ random_rotations(rng, k)
    if squashed and k:
        poses[rng.integers(k), :3, rng.integers(3)] = 0.0
    poses[:, :3, 3] = rng.uniform(-5, 5, (k, 3)) + offset
    which = rng.integers(0, 3, k)
    moved = [Mesh(transform_points(p, meshes[m].vertices), meshes[m].faces) for m, p in zip(which, poses, strict=True)]
    return rng, InstancedScene(meshes, which, poses), moved


@given(
    seed=st.integers(0, 2**32),
    k=st.integers(1, 60) | st.just(1000),
    squashed=st.booleans(),
    offset=st.sampled_from([0.0, 5.4e6]),
    n=st.sampled_from([150, 2048]),
)
def test_instances_give_the_hits_of_one_merged_mesh(seed, k, squashed, offset, n):
    rng, scene, moved = scene_and_flat(seed, k, squashed, offset)
    flat, source = merge_meshes_with_sources(moved)
    first = np.cumsum([0, *(len(m.faces) for m in moved)])
    caster = RayCaster(flat)
    origins, directions = rng.uniform(-8, 8, (n, 3)) + offset, rng.normal(size=(n, 3))
    rays = RayList(origins, directions)
    ours, theirs = scene.first_hits(rays), caster.cast(origins, directions)
    # The two float32 frames may put a ray on different sides of an edge, or swap two crossing surfaces.
    same = np.where(theirs.hit, source[theirs.face], -1) == ours.instance
    assert (~same).sum() <= 2 + n / 1000
    both = same & ours.hit
    np.testing.assert_allclose(ours.distance[both], theirs.distance[both], atol=CLOSE)
    # Faces of a squashed copy are coplanar, so a ray that hits several may report any of them.
    named = flat.vertices[flat.faces[ours.face[both] + first[ours.instance[both]]]]
    along = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    met = origins[both] + ours.distance[both, None] * along[both]
    with np.errstate(invalid="ignore"):  # faces without area
        off = np.linalg.norm(trimesh.triangles.closest_point(named, met) - met, axis=1)
    assert not (off > CLOSE).any()
    np.testing.assert_array_equal(np.isinf(ours.distance), ours.instance < 0)
    assert (scene.occlusion(rays) != theirs.hit).sum() <= 2 + n / 1000


@given(seed=st.integers(0, 2**32), k=st.integers(1, 60), n=st.sampled_from([150, 2048]))
def test_a_limit_excludes_hits_beyond_it(seed, k, n):
    rng, scene, _ = scene_and_flat(seed, k, False)
    rays = RayList(rng.uniform(-8, 8, (n, 3)), rng.normal(size=(n, 3)))
    limit = rng.uniform(0, 10, n)
    free, cut = scene.first_hits(rays), scene.first_hits(rays, max_distance=limit)
    clearly = np.abs(free.distance - limit) > CLOSE
    np.testing.assert_array_equal(cut.hit[clearly], (free.distance <= limit)[clearly])
    np.testing.assert_array_equal(cut.distance[cut.hit & clearly], free.distance[cut.hit & clearly])
    blocked = scene.occlusion(rays, max_distance=limit)
    np.testing.assert_array_equal(blocked[clearly], cut.hit[clearly])


@given(seed=st.integers(0, 2**32), k=st.integers(0, 30), axis=st.integers(0, 3), bundle=st.booleans())
def test_the_tree_finds_the_boxes_of_a_plain_loop(seed, k, axis, bundle):
    rng = np.random.default_rng(seed)
    low = rng.integers(-4, 5, (k, 3)).astype(float)
    bounds = np.stack([low, low + rng.integers(0, 3, (k, 3))], axis=1)
    # Whole numbers, so that rays run within sides and through edges, and boxes touch or have no thickness.
    origins = rng.integers(-6, 7, (12, 3)).astype(float)
    directions = rng.integers(-2, 3, (12, 3)).astype(float)
    directions[(directions == 0).all(axis=1)] = np.eye(3)[axis % 3]
    if bundle:
        origins = origins[:1] + rng.integers(0, 2, (12, 3)) / 4
        directions = directions[:1] + rng.integers(-1, 2, (12, 3)) / 64
    reach = rng.uniform(0, 8, 12)
    ray, crossed, _ = BoxTree(bounds).ray_box_crossings(origins, directions, reach)
    pairs = list(zip(ray.tolist(), crossed.tolist(), strict=True))
    assert len(pairs) == len(set(pairs))
    every = [(i, j) for i in range(12) for j in range(k)]
    least = {(i, j) for i, j in every if _crosses(origins[i], directions[i], reach[i], bounds[j], 0.0)}
    most = {(i, j) for i, j in every if _crosses(origins[i], directions[i], reach[i], bounds[j], 1e-12)}
    assert least <= set(pairs) <= most
    query, box = BoxTree(bounds).overlapping_pairs(origins, origins + 2)
    touching = (bounds[None, :, 0] <= origins[:, None] + 2).all(2) & (bounds[None, :, 1] >= origins[:, None]).all(2)
    assert sorted(zip(query.tolist(), box.tolist(), strict=True)) == list(map(tuple, np.argwhere(touching).tolist()))


def _crosses(origin, direction, reach, box, slack):
    enter, leave = Fraction(0), Fraction(reach) + Fraction(slack)
    for o, d, low, high in zip(origin, direction, *box, strict=True):
        o, d, low, high = Fraction(o), Fraction(d), Fraction(low) - Fraction(slack), Fraction(high) + Fraction(slack)
        if d == 0:
            if not low <= o <= high:
                return False
        else:
            a, b = sorted(((low - o) / d, (high - o) / d))
            enter, leave = max(enter, a), min(leave, b)
    return enter <= leave


@given(seed=st.integers(0, 2**32), size=st.floats(0.1, 3))
def test_triangles_and_boxes_touch_a_box_where_clipping_leaves_something(seed, size):
    rng = np.random.default_rng(seed)
    triangles = rng.normal(0, 1.5, (60, 1, 3)) + rng.normal(0, size, (60, 3, 3))
    half, other = rng.uniform(0.2, 1.5, (2, 60, 3))
    sides = np.concatenate([np.eye(3), -np.eye(3)])
    planes = [np.c_[sides, np.tile(h, 2)] for h in half]
    expected = [len(clipped(t, p)) > 0 for t, p in zip(triangles, planes, strict=True)]
    touching = triangle_box_touch_mask([*map(list, np.moveaxis(triangles, 0, 2))], list(half.T))
    np.testing.assert_array_equal(touching, expected)
    poses = rigid_matrix(random_rotations(rng, 60), rng.normal(0, size, (60, 3)))
    squares = transform_points(poses, (2.0 * CORNERS - 1.0) * other[:, None])[:, QUADS]
    # Its sides go through the box, or it's all around the box.
    expected = [any(map(len, (clipped(q, p) for q in each))) for each, p in zip(squares, planes, strict=True)]
    expected |= (np.abs(invert_rigid(poses)[:, :3, 3]) <= other).all(axis=1)
    np.testing.assert_array_equal(box_pair_touch_mask(half, other, poses), expected)
