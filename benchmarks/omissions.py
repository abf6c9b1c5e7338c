"""What is deliberately not modelled, and how much that leaves out: leaves, springs, soil, lenses, air, thin parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks import omissions_cutouts, omissions_ground, omissions_leaves, omissions_optics
from benchmarks.camera import HD
from benchmarks.omissions_ground import DISTANCES


def run(quick: bool) -> dict[str, Any]:
    """Measure everything; seeded."""
    return {
        "leaves": omissions_leaves.measure(quick),
        "cutouts": omissions_cutouts.speed(quick),
        "texels": omissions_cutouts.texels_kept(quick),
        "suspension": omissions_ground.suspension(quick),
        "soil": omissions_ground.soil(),
        "lens": omissions_optics.lens(quick),
        "thin_parts": omissions_optics.thin_parts(quick),
        "formulas": omissions_optics.formulas(),
    }


def report(results: dict[str, Any]) -> str:
    """The figures as a section of docs/benchmarks.md."""
    parts = ["## What is not modelled, and what that leaves out"]
    parts += [_leaves(results["leaves"]), _speed(results["cutouts"]), _kept(results["texels"])]
    parts += [_suspension(results["suspension"]), _soil(results["soil"])]
    parts += [_lens(results["lens"]), _thin_parts(results["thin_parts"]), _formulas(results["formulas"])]
    return "\n\n".join(parts)


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _leaves(leaves: dict[str, Any]) -> str:
    rows = []
    for wood in leaves["woods"]:
        found = omissions_leaves.summary(wood)
        rows.append([
            wood["kind"], f"{wood['trees']:,}", f"{wood['opaque']:.0%}", f"{wood['density']:g}",
            f"{found['planned_cards']:.3f}", f"{found['shown_cards']:.3f}",
            *(" / ".join(f"{x:+.4f}" for x in found[f"more_{made_of}"]) for made_of in ("cards", "leaves", "quads")),
            f"{found['lost_cards']:.0%}, {found['lost_quads']:.0%}",
        ])  # fmt: skip
    return (
        "### Leaf cards: visible share, planned against the picture\n\n"
        f"A tank 45 m off among trees of textured cards, {leaves['views']} views a row, {leaves['pixels']:,.0f} pixels "
        f"of target; planned with {leaves['rays']:,} rays, shown by Cycles' own mask with the textures' holes. "
        "More: shown less planned, mean / median / worst view. Control: the same leaves cut out as triangles. Whole "
        "quads: what holes matter, as if the plan did not know them. "
        f"Lost: views planned below {omissions_leaves.BAND} that show at least that, with holes, with whole quads. "
        "Atlas: the texture is a quarter of another one, through a Mapping node, read from a .blend file.\n\n"
    ) + _table(
        [
            "tree", "trees", "opaque", "trees to 100 m²", "planned", "shown", "more, cards",
            "more, leaves as geometry", "more, whole quads", "lost",
        ],
        rows,
    )  # fmt: skip


def _speed(rows: list[dict[str, Any]]) -> str:
    lines = [
        [
            row["kind"], f"{row['clear']:.0%}", f"{row['trees']:,}",
            *(f"{row['rays_a_second'][made_of] / 1e6:.2f}" for made_of in omissions_cutouts.MADE_OF),
            f"{row['rays_a_second']['quads'] / row['rays_a_second']['cards']:.2f}",
        ]
        for row in rows
    ]  # fmt: skip
    return (
        "### Leaf cards: speed\n\n"
        "Million rays a second of `visible_fraction` on one core, the best of several runs.\n\n"
    ) + _table(
        ["tree", "clear", "trees", "whole quads", "cards with holes", "leaves as geometry", "quads / cards"], lines
    )


def _kept(rows: list[dict[str, Any]]) -> str:
    lines = [
        [str(row["texels"]), f"{row['bytes'] / 1024:,.1f}", *(f"{row[key]:.4f}" for key in ("mean", "worst", "mask"))]
        for row in rows
    ]
    return (
        "### Leaf cards: texels kept against error\n\n"
        f"The visible shares of the wood of crowns, {omissions_cutouts.LARGEST} texels across a card against fewer "
        "(`assets.texture_size`): what one texture takes of memory, how far shares are off on average and at worst, "
        "and the lookups that hide with one of the two only, as masks see it.\n\n"
    ) + _table(["texels", "KiB", "share, mean", "share, worst", "masks"], lines)


def _suspension(rows: list[dict[str, Any]]) -> str:
    def both(pair: list[float], digits: int) -> str:
        return f"{pair[0]:.{digits}f} / {pair[1]:.{digits}f}"

    lines = [
        [
            r["terrain"], f"{r['travel_m']:.2f}", both(r["rigid_gap_m"], 2), both(r["left_gap_m"], 2),
            f"{r['hanging']:.0%}", f"{r['still_hanging']:.0%}", both(r["body_up_m"], 2), both(r["tilt_deg"], 1),
            *(both(r["box_px"][str(d)], 1) for d in DISTANCES),
        ]
        for r in rows
    ]  # fmt: skip
    return (
        "### Suspension: rigid tracks against sprung wheels\n\n"
        "The planned rest pose of a tank (support rule; tracks of 0.6 m, a belly 0.45 m above their soles) against "
        "that of the same tank on 2 x 7 sprung wheels of so much travel up and down, in balance; median / p95. Gap: "
        "the widest under a wheel. Hanging: wheels more than 2 cm above the ground when rigid; then: beyond their "
        "droop when sprung. Height, tilt: what the hull's pose changes by. Box: the largest change of a side, 1920 x "
        "1080, 50 degrees; pictures are rendered in the planned pose, so box and picture agree either way.\n\n"
    ) + _table(
        [
            "terrain", "travel (m)", "gap, rigid (m)", "gap, sprung (m)", "hanging", "then", "height (m)", "tilt (deg)",
            *(f"box at {d:.0f} m (px)" for d in DISTANCES),
        ],
        lines,
    )  # fmt: skip


def _soil(rows: list[dict[str, Any]]) -> str:
    lines = [
        [
            r["load"], f"{r['kpa']:.0f}", f"{r['width_m']:.2f}", r["soil"], f"{100 * r['sinkage_m']:.1f}",
            *(f"{r['px'][str(d)]:.1f}" for d in DISTANCES),
        ]
        for r in rows
    ]  # fmt: skip
    return (
        "### Soil: sinkage\n\n"
        "Bekker's law, p = (k_c / b + k_phi) z^n, for a plate of width b at rest; soil values from Wong, Theory of "
        "Ground Vehicles.\n\n"
    ) + _table(["load", "kPa", "width (m)", "soil", "sinkage (cm)", *(f"px at {d:.0f} m" for d in DISTANCES)], lines)


def _lens(rows: list[dict[str, Any]]) -> str:
    lines = [
        [
            f"{r['k1']:g}", f"{r['corner_px']:.1f}", f"{r['half_px']:.1f}",
            " / ".join(f"{x:.1f}" for x in r["side_px"]), " / ".join(f"{x:.1f}" for x in r["border_px"]),
        ]
        for r in rows
    ]  # fmt: skip
    return (
        "### Lens distortion\n\n"
        f"Brown's k1, 60 degrees at 1920 x 1080; {rows[0]['boxes']:,} boxes of a tank all over the frame, its surface "
        "distorted vertex by vertex; median / p95 / worst, px. The last column: the border of the undistorted box, "
        "distorted, instead of the surface.\n\n"
    ) + _table(
        ["k1", "corner (px)", "half-way (px)", "sides of the box, if it is ignored", "if the box is distorted"], lines
    )


def _thin_parts(rows: list[dict[str, Any]]) -> str:
    lines = [
        [
            str(r["height_px"]), f"{r['antenna_distance_m']:.0f}", f"{r['px_thick']:.2f}",
            *(" / ".join(f"{x:.2f}" for x in r[name]) for name in ("antenna", "plain")),
        ]
        for r in rows
    ]  # fmt: skip
    length, thick = omissions_optics.ANTENNA
    return (
        "### Parts thinner than a pixel\n\n"
        f"A tank with an antenna of {length} m and {100 * thick:.0f} cm on its turret, {rows[0]['views']} views a row: "
        "the largest distance between a side of the exact box and of the box of the mask at pixel centres; median / "
        "p95 / worst, px.\n\n"
    ) + _table(["box height (px)", "distance (m)", "antenna's thickness (px)", "with antenna", "without"], lines)


def _formulas(rows: list[dict[str, Any]]) -> str:
    lines = [
        [r["what"], r["case"], r["formula"], "" if r["metres"] is None else f"{r['metres']:.3f}", f"{r['px']:.2f}"]
        for r in rows
    ]
    return f"### By formula (1920 x 1080, f = {HD.f_px:.0f} px)\n\n" + _table(
        ["left out", "case", "formula", "metres", "px"], lines
    )


def plots(results: dict[str, Any], folder: Path) -> list[Path]:
    """Shown against planned shares; pixels against distance; boxes against the size of the target."""
    figure = Figure(figsize=(12, 3.8), layout="constrained")
    shares, ground, thin = figure.subplots(1, 3)
    for made_of, label, marker in (("cards", "leaf cards", "o"), ("leaves", "leaves as geometry", "x")):
        woods = results["leaves"]["woods"]
        planned, shown = (np.concatenate([w[f"{key}_{made_of}"] for w in woods]) for key in ("planned", "shown"))
        shares.plot(planned, shown, marker, markersize=4, linestyle="none", label=label, alpha=0.7)
    shares.plot([0, 1], [0, 1], "k:", linewidth=1)
    shares.set(xlabel="planned visible share", ylabel="shown by Cycles")
    for row in results["suspension"]:
        if row["travel_m"] == max(omissions_ground.TRAVEL):
            label = f"springs, {row['terrain']}"
            ground.loglog(DISTANCES, [row["box_px"][str(d)][0] for d in DISTANCES], "o-", label=label)
    for row in results["soil"]:
        if row["kpa"] == min(load[0] for load in omissions_ground.LOADS.values()):
            label = f"tank in {row['soil']}"
            ground.loglog(DISTANCES, [row["px"][str(d)] for d in DISTANCES], "s--", label=label)
    ground.set(xlabel="distance (m)", ylabel="change in the picture (px, median)")
    for name, column in (("with antenna", "antenna"), ("without", "plain")):
        for place, style in ((0, "o-"), (2, "o:")):
            values = [row[column][place] for row in results["thin_parts"]]
            label = f"{name}, {'worst' if place else 'median'}"
            color = "tab:red" if column == "antenna" else "tab:blue"
            thin.loglog([row["height_px"] for row in results["thin_parts"]], values, style, color=color, label=label)
    thin.set(xlabel="height of the box (px)", ylabel="exact box less mask's (px)")
    heights = [row["height_px"] for row in results["thin_parts"]]
    for panel, ticks in ((ground, DISTANCES), (thin, heights)):
        panel.minorticks_off()
        panel.set_xticks(ticks, [f"{tick:.0f}" for tick in ticks])
    ground.set_ylim(bottom=0.02)  # room for the legends
    thin.set_ylim(top=500.0)
    for panel, place in ((shares, "upper left"), (ground, "lower left"), (thin, "upper right")):
        panel.grid(True, which="both", alpha=0.3)
        panel.legend(fontsize=7, loc=place)
    path = Path(folder) / "omissions.png"
    figure.savefig(path, dpi=120)
    return [path]
