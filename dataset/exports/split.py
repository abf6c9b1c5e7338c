"""Split a dataset's images into train, valid, and test, whole positions at a time."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from hulldown.annotate.records import Image
from hulldown.dataset.images import group_images_by_position

SPLIT_NAMES = ("train", "valid", "test")
_WITHOUT, _IMAGES = -1, -2  # labels for images without objects, and for images; COCO ids are 0 or more


def split_name_by_image_id(
    images: Sequence[Image], *, fractions: tuple[float, float, float] = (0.7, 0.2, 0.1), seed: int = 0
) -> dict[int, str]:
    """Assign whole groups of images to splits in proportion (Sechidis et al., ECML PKDD 2011, algorithm 1)."""
    # nan fails each comparison.
    if len(fractions) != 3 or not all(f >= 0.0 for f in fractions) or not abs(sum(fractions) - 1.0) <= 1e-6:
        raise ValueError(f"fractions: expected three shares that are not negative and add up to 1, got {fractions}")
    groups = group_images_by_position(images)
    names = sorted(groups, key=lambda name: shuffle_key(name, seed))
    labels = [_numbered_class_labels(groups[name]) for name in names]
    kinds = sorted({label for of_image in labels for label in of_image})
    column = {kind: i for i, kind in enumerate(kinds)}
    rows = np.repeat(np.arange(len(names)), [len(of_image) for of_image in labels])
    columns = [column[label] for of_image in labels for label in of_image]
    has = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(names), len(kinds)))
    chosen = _assign_rows_to_parts(has, np.array(fractions))
    return {image.id: SPLIT_NAMES[k] for name, k in zip(names, chosen, strict=True) for image in groups[name]}


def _numbered_class_labels(images: Iterable[Image]) -> list[tuple[int, int]]:
    """Return (class, 1) to (class, k) for k objects of a class, and the same for images, and images without objects."""
    counts: Counter[int] = Counter()
    for image in images:
        counts.update([label.category_id for label in image.labels] or [_WITHOUT])
        counts[_IMAGES] += 1
    return [(kind, k) for kind, n in counts.items() for k in range(1, n + 1)]


def _assign_rows_to_parts(has: sparse.csr_matrix, shares: Float[np.ndarray, " s"]) -> Int[np.ndarray, " n"]:
    """Assign rows to parts: those with the rarest label first, to the part that lacks it most."""
    wanted = np.outer(shares, has.sum(axis=0))  # (s, l) how often each part should still get each label
    chosen = np.full(has.shape[0], -1)
    left = np.asarray(has.sum(axis=0)).ravel()
    by_label = has.tocsc()
    used = np.flatnonzero(shares > 0.0)
    while (left > 0).any():
        rarest = int(np.flatnonzero(left > 0)[np.argmin(left[left > 0])])
        for row in by_label.indices[by_label.indptr[rarest] : by_label.indptr[rarest + 1]]:
            if chosen[row] >= 0:
                continue
            row_labels = has.indices[has.indptr[row] : has.indptr[row + 1]]
            lacks = np.round(np.stack([wanted[used, rarest], wanted[used][:, row_labels].sum(axis=1)]), 9)
            chosen[row] = used[np.lexsort(lacks[::-1])[-1]]
            wanted[chosen[row], row_labels] -= 1.0
            left[row_labels] -= 1.0
    # Rounding always favors the largest part. Move rows while that brings labels closer to their shares.
    size = np.asarray(has.sum(axis=1)).ravel()
    for _ in range(len(chosen)):
        lacks = has @ wanted.T  # (n, s)
        gain = lacks[:, used] - lacks[np.arange(len(chosen)), chosen][:, None] - size[:, None]
        gain[chosen[:, None] == used] = -np.inf
        row, k = np.unravel_index(np.argmax(gain), gain.shape)
        if not gain[row, k] > 1e-9:
            break
        row_labels = has.indices[has.indptr[row] : has.indptr[row + 1]]
        wanted[chosen[row], row_labels] += 1.0
        chosen[row] = used[k]
        wanted[chosen[row], row_labels] -= 1.0
    return chosen


def shuffle_key(name: str, seed: int) -> bytes:
    """Return a sort key for an order that depends on the names and the seed alone."""
    return hashlib.sha256(f"{seed} {name}".encode()).digest()
