"""Compare a plan or a dataset with photographs: the distance in each feature, and the config keys that change it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.figure import Figure
from PIL import Image as Pictures
from scipy.stats import ks_2samp

from hulldown.assets.photographs import Photographs
from hulldown.assets.picture_files import read_pixels
from hulldown.base.errors import DatasetError
from hulldown.base.terminal import reporting
from hulldown.dataset.reports.charts import BINS, two_histograms
from hulldown.dataset.reports.coverage import FEWEST, Coverage, coverage_of
from hulldown.dataset.table import Dataset
from hulldown.geometry.color import LUMINANCE
from hulldown.geometry.indices import spread

SPLITS = 40  # random halves of the photographs
MOST_PICTURES = 500  # most measured pictures, spread evenly
SIDE = 512  # pixels of the longer side at which pictures are measured
COARSEST = 4  # cycles per picture from which the spectrum's slope is fitted: below, it's the scene's layout


@dataclass(frozen=True, slots=True)
class Feature:
    """A feature of pictures or boxes."""

    name: str  # name, title: its name for programs, and for readers
    title: str
    keys: str  # the config keys that change it
    log: bool = False  # whether ratios matter instead of differences


BOXES = (
    Feature("height", "box height / picture height", "camera.target_fraction or camera.like", log=True),
    Feature("x", "box center from left to right", "camera.framing or camera.like"),
    Feature("y", "box center from top to bottom", "camera.framing or camera.like"),
    Feature(
        "aspect",
        "box width / height",
        "camera.elevation_deg, camera.like, turret_limits_deg of vehicles, or the models, also companions",
        log=True,
    ),
    Feature("cut", "boxes that the frame cuts off", "camera.truncated_fraction or camera.like"),
    Feature("count", "boxes in a picture", "placement.vehicles_per_image, budget.background_share, or camera.like"),
)
LOOKS = (
    Feature("brightness", "brightness (mean luma)", "light.exposure and light.exposure_error_ev"),
    Feature("contrast", "contrast (deviation of luma)", "light.hdris and weather"),
    Feature("saturation", "saturation (mean range of a pixel's colors)", "light.hdris, weather, and the sceneries"),
    Feature("warmth", "warmth (mean red minus blue)", "light.hdris and light.white_balance_error_k"),
    Feature("spectrum", "fine detail (slope of the power spectrum)", "the sceneries' textures and render.denoise"),
)
Encoder = Callable[[Sequence[UInt8[np.ndarray, "_ _ 3"]]], Float[np.ndarray, "n d"]]
Values = dict[str, tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]]  # of each feature, and of which picture


@dataclass(frozen=True, eq=False, slots=True)
class Compared:
    """A feature of dataset and photographs."""

    feature: Feature
    distance: float  # kolmogorov-Smirnov: the largest difference of the two cumulative distributions, 0 to 1
    floor: float  # 95th percentile of that distance between random halves of the photographs; nan of fewer than four
    # edges of the common bins: nearly all values of both, with one bin per value if they're few
    edges: Float[np.ndarray, " b_plus_1"]
    # own, photographs: the share of each side's values in each bin; outliers are in the first or last
    own: Float[np.ndarray, " b"]
    photographs: Float[np.ndarray, " b"]

    @property
    def differs(self) -> bool:
        """Whether chance among the photographs doesn't explain the distance."""
        return self.distance > self.floor

    @property
    def sentence(self) -> str:
        """The largest surplus and lack in words, with the keys to change."""
        if self.feature.name == "cut":  # two bins, of whole boxes and of cut ones
            have, wanted = self.own[1], self.photographs[1]
            verdicts = [f"{'too many' if have > wanted else 'too few'} ({have:.0%}, photographs {wanted:.0%})"]
        else:
            verdicts = []
            for sign, verdict in ((1.0, "too much"), (-1.0, "too little")):
                low, stop = _largest_run(sign * (self.own - self.photographs))
                have, wanted = self.own[low:stop].sum(), self.photographs[low:stop].sum()
                verdicts.append(f"{verdict} {self._between(low, stop)} ({have:.0%}, photographs {wanted:.0%})")
        return f"{self.feature.title.capitalize()}: {', '.join(verdicts)}. Change {self.feature.keys}."

    def _between(self, low: int, stop: int) -> str:
        edges = self.edges
        if edges[0] % 1.0 == 0.5:  # whole numbers
            first, last = round(edges[low] + 0.5), round(edges[stop] - 0.5)
            return f"of {first}" if first == last else f"of {first} to {last}"
        if low == 0:
            return f"below {edges[stop]:.2g}"
        return f"above {edges[low]:.2g}" if stop == len(edges) - 1 else f"from {edges[low]:.2g} to {edges[stop]:.2g}"


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """The comparison in all common features."""

    source: Path
    features: tuple[Compared, ...]  # one for each feature, boxes first
    notes: tuple[str, ...]  # features that weren't compared, with reasons
    # of whole images in an encoder's features; None without an encoder, or with too few photographs
    coverage: Coverage | None = None

    @property
    def sentences(self) -> list[str]:
        """Sentences about surplus and lack that chance doesn't explain, largest distance first."""
        apart = sorted(self.features, key=lambda compared: -compared.distance)
        whole = [] if self.coverage is None else [self.coverage.sentence()]
        return whole + [compared.sentence for compared in apart if compared.differs]

    def to_json(self) -> dict[str, object]:
        """Everything as plain numbers."""
        return {
            "photographs": str(self.source),
            "features": {
                one.feature.name: {
                    "distance": round(one.distance, 6),
                    "floor": None if np.isnan(one.floor) else round(one.floor, 6),
                    "keys": one.feature.keys,
                    "edges": one.edges.tolist(),
                    "own": one.own.round(6).tolist(),
                    "photographs": one.photographs.round(6).tolist(),
                }
                for one in self.features
            },
            "coverage": None if self.coverage is None else asdict(self.coverage),
            "sentences": self.sentences,
            "notes": list(self.notes),
        }

    def charts(self) -> dict[str, Figure]:
        """Histograms of dataset and photographs for each feature, by description."""
        return {
            f"{one.feature.title}: this dataset and the photographs": two_histograms(
                one.feature.title, one.edges, (one.own, one.photographs), log=one.feature.log
            )
            for one in self.features
        }


def compare(
    dataset: Dataset,
    photographs: Photographs,
    *,
    pixels: bool,
    encode: Encoder | None = None,
) -> Comparison:
    """Compare a dataset or a plan with photographs, feature by feature."""
    for boxes, named in ((len(photographs.image), photographs.path), (len(dataset.labels["id"]), Path(dataset.name))):
        if not boxes:
            raise DatasetError("has no boxes to compare", path=named, remedy="label some pictures")
    own, wanted = _boxes_of(boxes_in(dataset)), _boxes_of(photographs)
    notes, coverage = [], None
    folder = photographs.path.parent
    files = [path for name in photographs.file_names if (path := _inside(folder, name)) is not None]
    if pixels and files:
        dataset_rows, photograph_rows = spread(len(dataset.images), MOST_PICTURES), spread(len(files), MOST_PICTURES)
        own_pictures, pictures = [], []
        with reporting("comparing", None) as advance:
            for done, i in enumerate([*dataset_rows.tolist(), *photograph_rows.tolist()], start=1):
                if done <= len(dataset_rows):
                    own_pictures.append(_small(np.asarray(dataset.picture(i, labels=False).convert("RGB"))))
                else:
                    pictures.append(_small(read_pixels(files[i])))
                advance(done, len(dataset_rows) + len(photograph_rows))
        own, wanted = own | _looks_of(own_pictures), wanted | _looks_of(pictures)
        if encode is not None and len(pictures) < FEWEST:
            notes.append(f"Coverage needs {FEWEST} photographs; there are {len(pictures)}.")
        elif encode is not None:
            coverage = coverage_of(encode(own_pictures), encode(pictures))
    elif pixels:
        notes.append(f"None of the photographs' pictures is in {folder}, so that only boxes are compared.")
    elif encode is not None:
        notes.append("Coverage needs pictures, which a plan doesn't have yet.")
    if len(photographs.file_names) < 4:
        notes.append("Fewer than four photographs: what chance explains isn't known.")
    features = [
        _compared(feature, own[name][0], *wanted[name])
        for feature in (*BOXES, *LOOKS)
        if (name := feature.name) in own and len(own[name][0]) and len(wanted[name][0])
    ]
    return Comparison(photographs.path, tuple(features), tuple(notes), coverage)


def boxes_in(dataset: Dataset) -> Photographs:
    """Return the boxes of a dataset or a plan in the form of photographs, without crowds."""
    labels, images = dataset.labels, dataset.of_images
    rows = np.flatnonzero(~labels["crowd"])
    image = labels["image"][rows]
    size = np.stack([images["width"], images["height"]], axis=1).astype(np.float64)
    xywh = np.stack([labels[key][rows] for key in ("x", "y", "width", "height")], axis=1) / np.tile(size[image], 2)
    cut = np.nan_to_num(labels["truncated_fraction"][rows]) > 0.0
    return Photographs(
        Path(dataset.name), "", tuple(images["file_name"].tolist()), size, image, xywh,
        tuple(labels["category"][rows].tolist()), np.repeat(cut[:, None], 4, axis=1),
    )  # fmt: skip


def distance(own: Float[np.ndarray, " n"], photographs: Float[np.ndarray, " m"]) -> float:
    """Kolmogorov and Smirnov's statistic of two samples."""
    return float(ks_2samp(own, photographs, method="asymp").statistic)


def looks(picture: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "5"]:
    """Brightness, contrast, saturation, warmth, and slope of the power spectrum (nan if it's too small for one)."""
    colors = picture / 255.0
    luma = colors @ LUMINANCE
    warmth = float(colors[..., 0].mean() - colors[..., 2].mean())
    saturation = float(np.ptp(colors, axis=2).mean())
    return np.array([luma.mean(), luma.std(), saturation, warmth, spectral_slope(luma)])


def spectral_slope(luma: Float[np.ndarray, "h w"]) -> float:
    """Slope of log power over log frequency, averaged over directions; about -2 in photographs of nature.

    References
    ----------
    Field, Relations between the statistics of natural images and the response properties of cortical cells, JOSA A
    1987.
    """
    side = min(luma.shape)
    if side < 8 * COARSEST or np.ptp(luma) == 0.0:
        return np.nan
    top, left = (luma.shape[0] - side) // 2, (luma.shape[1] - side) // 2
    square = luma[top : top + side, left : left + side]
    window = np.hanning(side)
    power = np.abs(np.fft.rfft2((square - square.mean()) * np.outer(window, window))) ** 2
    frequency = np.hypot(np.fft.fftfreq(side, 1 / side)[:, None], np.fft.rfftfreq(side, 1 / side))
    ring = np.round(frequency).astype(int)
    rings = np.arange(COARSEST, side // 2)
    mean = np.bincount(ring.ravel(), power.ravel())[rings] / np.bincount(ring.ravel())[rings]
    return float(np.polyfit(np.log(rings), np.log(mean + 1e-12), 1)[0])


def _boxes_of(photographs: Photographs) -> Values:
    x, y = photographs.center.T
    cut = photographs.cut.any(axis=1)
    columns = {"height": photographs.height, "x": x, "y": y, "aspect": photographs.aspect, "cut": cut}
    # Rounded, so that a box has the same value however it was computed.
    values = {name: (column.astype(np.float64).round(9), photographs.image) for name, column in columns.items()}
    return values | {"count": (photographs.count.astype(np.float64), np.arange(len(photographs.file_names)))}


def _looks_of(pictures: Sequence[UInt8[np.ndarray, "h w 3"]]) -> Values:
    columns = np.array([looks(picture) for picture in pictures]).T
    known = [np.flatnonzero(np.isfinite(column)) for column in columns]
    return {one.name: (column[rows], rows) for one, column, rows in zip(LOOKS, columns, known, strict=True)}


def _compared(
    feature: Feature,
    own: Float[np.ndarray, " n"],
    photographs: Float[np.ndarray, " m"],
    image: Int[np.ndarray, " m"],
) -> Compared:
    """Compare the values of a feature; `image` is the photograph of each of the second."""
    both = np.concatenate([own, photographs])
    low, high = np.quantile(both, [0.005, 0.995])
    if len(different := np.unique(both)) <= BINS // 2 and (different == np.round(different)).all():
        edges = np.arange(different[0], different[-1] + 2) - 0.5
    elif feature.log:
        edges = np.geomspace(*((low, high) if low < high else (low / 2, high * 2)), BINS + 1)
    else:
        edges = np.linspace(*((low, high) if low < high else (low - 0.5, high + 0.5)), BINS + 1)
    shares = [np.histogram(np.clip(side, edges[0], edges[-1]), edges)[0] / len(side) for side in (own, photographs)]
    return Compared(feature, distance(own, photographs), _floor(photographs, image), edges, *shares)


def _floor(values: Float[np.ndarray, " n"], image: Int[np.ndarray, " n"]) -> float:
    """95th percentile of the distance between random halves of the photographs, each with all of its boxes."""
    pictures = np.unique(image)
    if len(pictures) < 4:
        return float("nan")
    rng = np.random.default_rng(0)
    distances = []
    for _ in range(SPLITS):
        first = np.isin(image, rng.permutation(pictures)[: len(pictures) // 2])
        distances.append(distance(values[first], values[~first]))
    return float(np.quantile(distances, 0.95))


def _largest_run(values: Float[np.ndarray, " b"]) -> tuple[int, int]:
    """Begin and end of the contiguous bins with the largest sum (Kadane)."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    gain = sums - np.minimum.accumulate(sums)
    stop = int(gain.argmax())
    return int(sums[: stop + 1].argmin()), stop


def _small(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h2 w2 3"]:
    image = Pictures.fromarray(picture)
    image.thumbnail((SIDE, SIDE), Pictures.Resampling.LANCZOS)
    return np.asarray(image)


def _inside(folder: Path, name: str) -> Path | None:
    """Return a picture of a COCO file; None if it's missing, or outside of the file's folder."""
    path = folder / name
    return path if name and path.is_file() and path.resolve().is_relative_to(folder.resolve()) else None
