"""Settings of Cycles (paper, section 2.1.4) on a scene with Blender's own settings."""

from __future__ import annotations

import math
import platform
from typing import Any

import bpy

from hulldown.render.blender.messages import CyclesSettings

GPU_KINDS = ("OPTIX", "CUDA", "HIP", "ONEAPI", "METAL")  # the faster of two for one card first
DENOISER = "OPENIMAGEDENOISE"
NEUTRAL_BALANCE_K, NEUTRAL_BALANCE_TINT = 6500.0, 10.0  # this white balance changes nothing, but for rounding
CLAMP_INDIRECT, LIGHT_THRESHOLD = 10.0, 0.01  # Blender's defaults, at an exposure of 0
MIN_THREADS = 2  # with one, a thread of its scheduler (TBB) busy-waits on another core
VIEW_TRANSFORM = "AgX"  # rolls highlights off as film does; Standard clips the sky of every sunny HDRI to flat white
TRANSPARENT_BOUNCES = 32  # leaves are cards with holes; Cycles' own 8 leaves black spots in a treetop


class Unusable(Exception):
    """Raised when Blender or the machine can't render any image as requested; args: the problem and the remedy."""


def available_devices() -> list[dict[str, str]]:
    """Return `kind` and `name` of every device for Cycles, preferred ones first, the CPU last."""
    preferences = _cycles_preferences()
    devices = [
        {"kind": device.type, "name": device.name}
        for kind in GPU_KINDS
        for device in _set_kind_and_list_cards(preferences, kind)
    ]
    preferences.compute_device_type = "NONE"
    return [*devices, {"kind": "CPU", "name": platform.processor() or platform.machine()}]


def activate_device(wanted: str, index: int = 0) -> tuple[str, int]:
    """Make Cycles render on the device `wanted`; return its name, and the number of devices of its kind."""
    preferences = _cycles_preferences()
    kinds: tuple[str, ...] = {"auto": GPU_KINDS, "gpu": GPU_KINDS, "cpu": ()}.get(wanted, (wanted.upper(),))
    for kind in kinds:
        if cards := _set_kind_and_list_cards(preferences, kind):
            own_card = cards[index % len(cards)]
            for device in preferences.devices:
                device.use = device == own_card
            return f"{kind} {own_card.name}", len(cards)
    if wanted not in ("auto", "cpu"):
        raise Unusable(f"Cycles finds no {wanted} device here", "use --device auto or cpu")
    preferences.compute_device_type = "NONE"
    return "CPU", 1


def _cycles_preferences() -> Any:
    addon = bpy.context.preferences.addons.get("cycles")
    if addon is None:
        raise Unusable(f"Blender {bpy.app.version_string} was built without Cycles", "use one from blender.org")
    return addon.preferences


def _set_kind_and_list_cards(preferences: Any, kind: str) -> list[Any]:
    try:
        preferences.compute_device_type = kind
    except TypeError:  # this build of Blender does not know the kind
        return []
    preferences.refresh_devices()
    return [device for device in preferences.devices if device.type == kind]


def configure_scene(scene: Any, settings: CyclesSettings, *, device: str, threads: int = 0) -> None:
    """Configure `scene` as planned, on this many CPU threads (0: all)."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    picture = render.image_settings
    picture.file_format, picture.color_mode, picture.color_depth = "PNG", "RGB", "8"
    picture.compression = 15  # zlib's higher levels take seconds at 1080p for 3 % of the size
    scene.view_settings.view_transform = VIEW_TRANSFORM
    render.threads_mode = "FIXED" if threads else "AUTO"
    if threads:
        render.threads = max(threads, MIN_THREADS)
    cycles.device = "CPU" if device == "CPU" else "GPU"
    cycles.samples = settings.samples
    cycles.use_adaptive_sampling = settings.adaptive_threshold > 0
    if cycles.use_adaptive_sampling:
        cycles.adaptive_threshold = settings.adaptive_threshold
    cycles.use_denoising = settings.denoise
    if cycles.use_denoising:
        _enable_denoiser(cycles, gpu=device != "CPU")
    # Blender's own proportions, with `bounces` on top: 12 gives exactly Blender's defaults.
    cycles.max_bounces = cycles.transmission_bounces = settings.bounces
    cycles.diffuse_bounces = cycles.glossy_bounces = min(4, settings.bounces)
    cycles.volume_bounces = 0
    cycles.transparent_max_bounces = TRANSPARENT_BOUNCES
    # Keeps textures, geometry and BVHs from one image to the next.
    render.use_persistent_data = True


def set_exposure_and_white_balance(scene: Any, settings: CyclesSettings, exposure: float, white_balance: float) -> None:
    """Set exposure in EV and the white balance's offset in kelvin; Cycles' limits of radiance are scaled too."""
    view, scale = scene.view_settings, 2.0**-exposure
    view.exposure = exposure
    view.use_white_balance = white_balance != 0.0
    # Resetting the white point has set both anew.
    view.white_balance_temperature, view.white_balance_tint = NEUTRAL_BALANCE_K + white_balance, NEUTRAL_BALANCE_TINT
    for name, value in (
        ("sample_clamp_indirect", CLAMP_INDIRECT * scale),
        ("light_sampling_threshold", min(LIGHT_THRESHOLD * scale, 1.0)),
        ("adaptive_threshold", min(settings.adaptive_threshold * math.sqrt(scale), 1.0)),  # over the root of radiance
    ):
        setattr(scene.cycles, name, value)


def _enable_denoiser(cycles: Any, *, gpu: bool) -> None:
    try:
        cycles.denoiser = DENOISER
    except TypeError:  # the distributions' builds often lack it
        raise Unusable(
            f"Blender {bpy.app.version_string} was built without OpenImageDenoise",
            "use the bpy module or a Blender from blender.org, or plan with `denoise = false`",
        ) from None
    cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    cycles.denoising_use_gpu = gpu
