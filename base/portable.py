"""Sines, angles, and logarithms with the same bits on every processor, from +, -, *, /, and square roots alone.

NumPy and the C library pick another implementation of these functions for each processor, and those differ in the last
bits. IEEE 754 leaves no choice for the four operations and the square root. Plans are made with the functions below.
They run in Blender too, which may have numpy only.

Sun Microsystems, fdlibm 5.3, 1993: the reductions of the arguments and the coefficients, with its errors below 1 ulp.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

# pi/2 in three parts, the first two of 33 bits: their products with small whole numbers are exact.
_PI_2_PARTS = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_PI_2_REST = 6.12323399573676603587e-17  # what the float64 math.pi / 2 lacks
_SIN = (
    1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06,
    -1.98412698298579493134e-04, 8.33333333332248946124e-03, -1.66666666666666324348e-01,
)  # fmt: skip
_COS = (
    -1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07,
    2.48015872894767294178e-05, -1.38888888888741095749e-03, 4.16666666666666019037e-02,
)  # fmt: skip
_ATAN = (
    1.62858201153657823623e-02, -3.65315727442169155270e-02, 4.97687799461593236017e-02, -5.83357013379057348645e-02,
    6.66107313738753120669e-02, -7.69187620504482999495e-02, 9.09088713343650656196e-02, -1.11111104054623557880e-01,
    1.42857142725034663711e-01, -1.99999999998764832476e-01, 3.33333333333329318027e-01,
)  # fmt: skip
_ATAN_HALF = (4.63647609000806093515e-01, 2.26987774529616870924e-17)  # arctan(1 / 2), and what float64 lacks of it
_ATAN_ONE = (7.85398163397448278999e-01, 3.06161699786838301793e-17)
_EXP = (
    4.13813679705723846039e-08, -1.65339022054652515390e-06, 6.61375632143793436117e-05,
    -2.77777777770155933842e-03, 1.66666666666666019037e-01,
)  # fmt: skip
_LOG = (
    1.479819860511658591e-01, 1.531383769920937332e-01, 1.818357216161805012e-01, 2.222219843214978396e-01,
    2.857142874366239149e-01, 3.999999999940941908e-01, 6.666666666666735130e-01,
)  # fmt: skip
_LN_2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)

Number = float | np.ndarray


def sin_cos(angle: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine of angles in radians, within 1 ulp; of more than a million turns, less."""
    x = np.asarray(angle, dtype=np.float64)
    turns = np.rint(x * (2.0 / math.pi))
    sine, cosine = _sin_cos_near_zero(x, turns)
    if not np.any(turns):
        return np.asarray(sine), np.asarray(cosine)
    quarter = turns.astype(np.int64) & 3
    odd = (quarter & 1) == 1
    s, c = np.where(odd, cosine, sine), np.where(odd, sine, cosine)
    return np.where(quarter >= 2, -s, s), np.where((quarter == 1) | (quarter == 2), -c, c)


def sin(angle: ArrayLike) -> np.ndarray:
    """Sine of angles in radians."""
    return sin_cos(angle)[0]


def tan(angle: ArrayLike) -> np.ndarray:
    """Tangent of angles in radians."""
    sine, cosine = sin_cos(angle)
    return np.asarray(sine / cosine)


def arctan2(y: ArrayLike, x: ArrayLike) -> np.ndarray:
    """Return angle in radians, -pi to pi, of the direction (x, y); 0 of (0, 0)."""
    down, across = np.abs(y), np.abs(x)
    larger = np.maximum(down, across)
    ratio = np.asarray(np.minimum(down, across) / np.where(larger > 0.0, larger, 1.0))
    angle = _arctan_up_to_one(ratio)
    angle = np.where(down > across, math.pi / 2 - (angle - _PI_2_REST), angle)
    angle = np.where(np.asarray(x) < 0.0, math.pi - (angle - 2.0 * _PI_2_REST), angle)
    return np.where(np.asarray(y) < 0.0, -angle, angle)


def arcsin(sine: ArrayLike) -> np.ndarray:
    """Return angle in radians, -pi/2 to pi/2, with this sine."""
    x = np.asarray(sine, dtype=np.float64)
    return arctan2(x, np.sqrt((1.0 - x) * (1.0 + x)))


def hypot(x: ArrayLike, y: ArrayLike) -> np.ndarray:
    """Length of (x, y), for numbers whose squares stay inside float64."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    return np.asarray(np.sqrt(x * x + y * y))


def exp(power: ArrayLike) -> np.ndarray:
    """Return the exponential function of numbers from -700 to 700."""
    x = np.asarray(power, dtype=np.float64)
    doublings = np.rint(x / math.log(2.0))
    high, low = x - doublings * _LN_2[0], doublings * _LN_2[1]
    r = high - low
    c = r - r * r * _evaluate_polynomial(_EXP, r * r)
    return np.asarray(np.ldexp(1.0 - ((low - r * c / (2.0 - c)) - high), doublings.astype(np.int64)))


def log(value: ArrayLike) -> np.ndarray:
    """Natural logarithm of positive numbers."""
    mantissa, doublings = np.frexp(value)
    small = mantissa < math.sqrt(0.5)
    f, k = np.where(small, 2.0 * mantissa, mantissa) - 1.0, doublings - 1.0 * small
    s, half = f / (2.0 + f), 0.5 * f * f
    r = s * s * _evaluate_polynomial(_LOG, s * s)
    return np.asarray(k * _LN_2[0] - ((half - (s * (half + r) + k * _LN_2[1])) - f))


def _sin_cos_near_zero(x: Number, turns: Number) -> tuple[Number, Number]:
    """Sine and cosine of x minus `turns` quarter turns, which is within pi/4 of zero."""
    first = x - turns * _PI_2_PARTS[0]
    second = turns * _PI_2_PARTS[1]
    left = first - second
    rest = turns * _PI_2_PARTS[2] - ((first - left) - second)
    r = left - rest
    tail = (left - r) - rest
    z = r * r
    cube = z * r
    sine = r - ((z * (0.5 * tail - cube * _evaluate_polynomial(_SIN[:-1], z)) - tail) - cube * _SIN[-1])
    half = 0.5 * z
    whole = 1.0 - half
    return sine, whole + (((1.0 - whole) - half) + (z * z * _evaluate_polynomial(_COS, z) - r * tail))


def _arctan_up_to_one(ratio: np.ndarray) -> np.ndarray:
    """Arc tangent of numbers from 0 to 1, computed about 0, 1/2, or 1."""
    half, one = (ratio >= 7.0 / 16.0) & (ratio < 11.0 / 16.0), ratio >= 11.0 / 16.0
    t = np.where(half, (2.0 * ratio - 1.0) / (2.0 + ratio), np.where(one, (ratio - 1.0) / (ratio + 1.0), ratio))
    about, lacking = (np.where(half, a, np.where(one, b, 0.0)) for a, b in zip(_ATAN_HALF, _ATAN_ONE, strict=True))
    return np.asarray(about - ((t * (t * t * _evaluate_polynomial(_ATAN, t * t)) - lacking) - t))


def _evaluate_polynomial(coefficients: tuple[float, ...], x: Number) -> Number:
    """Evaluate a polynomial by Horner's rule; the highest power's coefficient is first."""
    value: Number = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value
