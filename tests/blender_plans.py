"""Small plans of files that Blender makes and renders."""

import subprocess
import sys
from pathlib import Path

from planning.config import load_config
from planning.loading import load_assets
from planning.write import write_plan

IMAGES = 12
CONFIG = """
[assets]
hdris = ["grey.exr"]
vehicles = [{{path = "{vehicle}", category = "tank"}}]
sceneries = [{{path = "{scenery}"}}]
[budget]
images_per_class = {images}
[camera]
target_fraction = [0.3, 0.6]
[render]
width = 96
height = 54
samples = 2
"""


def make_worlds(folder, script="render_worlds.py"):
    """Run a script of this folder, in Blender, that writes files into another folder."""
    path = Path(__file__).with_name(script)
    subprocess.run([sys.executable, str(path), str(folder)], check=True, capture_output=True)


def plan_in(folder, *, vehicle="tank.blend", scenery="field.blend", images=IMAGES):
    """The path of a plan of pictures of 96 x 54 in a folder that has these files and grey.exr."""
    return make_plan(folder, CONFIG.format(vehicle=vehicle, scenery=scenery, images=images)).path


def make_plan(folder, text):
    """The plan of a config with this text, in a folder that has its files."""
    (folder / "hulldown.toml").write_text(text)
    config = load_config(folder / "hulldown.toml")
    return write_plan(config, load_assets(config), folder / "plan.jsonl")
