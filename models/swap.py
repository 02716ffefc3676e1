"""Loads a hydraulic leg with native motors on the same lines: needs no plugin library."""

from pathlib import Path

import mujoco

FOLDER = Path(__file__).parent
REPLACED = {
    "parts/cylinders.xml": "parts/motors.xml",
    "parts/springs_hydraulic.xml": "parts/springs_native.xml",
}


def load_with_motors(name: str) -> mujoco.MjModel:
    """Compiles `models/NAME.xml` after replacing the plugin parts by the native ones, in memory.

    Args:
        name: Model name without the suffix, for instance "leg_rail".

    Returns:
        The compiled model: same bodies, joints, sites and tendons, motors named `<joint>_valve`.
    """
    text = (FOLDER / f"{name}.xml").read_text()
    for hydraulic, native in REPLACED.items():
        text = text.replace(hydraulic, native)
    files = [*FOLDER.glob("parts/*.xml"), *FOLDER.glob("meshes/*.obj")]
    assets = {path.relative_to(FOLDER).as_posix(): path.read_bytes() for path in files}
    return mujoco.MjModel.from_xml_string(text, assets)
