"""Polygons clipped by planes, in the arithmetic of their coordinates: fractions or float64."""


def clipped(polygon, planes):
    """Corners of the part of a convex polygon where n · p + d >= 0 for every plane (*n, d): Sutherland and Hodgman."""
    for *normal, offset in planes:
        at = [sum(n * x for n, x in zip(normal, point, strict=True)) + offset for point in polygon]
        kept = []
        for i, (point, here) in enumerate(zip(polygon, at, strict=True)):
            before, there = polygon[i - 1], at[i - 1]
            if (here >= 0) != (there >= 0):
                kept.append([p + (q - p) * here / (here - there) for p, q in zip(point, before, strict=True)])
            if here >= 0:
                kept.append(point)
        polygon = kept
    return polygon
