import numpy as np
import pytest

from hulldown.base.color import LUMINANCE_WEIGHTS, linear_from_srgb, linear_rgb_from_hex, srgb_from_linear


def test_colors_are_linear_light():
    assert linear_rgb_from_hex("#ffffff") == (1.0, 1.0, 1.0)
    assert linear_rgb_from_hex("#808080") == pytest.approx((0.2158605,) * 3)
    assert LUMINANCE_WEIGHTS.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_encoding_inverts_decoding_to_precision(dtype):
    linear = np.linspace(0.0, 1.0, 1001, dtype=dtype)
    coded = srgb_from_linear(linear)
    again = linear_from_srgb(coded)
    assert coded.dtype == again.dtype == dtype
    assert coded[[0, -1]] == pytest.approx([0.0, 1.0])
    # The standard's two thresholds agree only to 3e-8.
    np.testing.assert_allclose(again, linear, atol=1e-7 if dtype is np.float64 else 1e-6)
