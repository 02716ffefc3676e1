"""Geometry of a cylinder on its joint: whether its stroke and lever arm fit the joint's range."""

from collections.abc import Mapping

import numpy as np

from leglab.base.errors import ModelError

# Least lever arm that counts as one, of the greatest in the joint's range.
_LEAST_LEVER = 1e-3


def check_cylinder(
    name: str,
    joint: str,
    sheet: Mapping[str, float],
    *,
    position: np.ndarray,
    lever: np.ndarray,
    length: np.ndarray,
    unit: str,
) -> None:
    """Refuses a cylinder that cannot sit where the model has it.

    Within the joint's range each chamber has a volume, its dead one as far as the piston is beyond
    its stroke, into the stops; and the lever arm keeps its sign.

    Args:
        name: Of the cylinder.
        joint: Name of the joint that it drives.
        sheet: Its parameters: `stroke`, `mid_length`, `bore`, `rod` [m], `dead_volume_a` and
            `dead_volume_b` [m^3] among them.
        position: Of the joint over its range [rad or m], (n,).
        lever: There, length per position [m/rad or 1], (n,).
        length: Distance of the anchors there [m], (n,).
        unit: Of the joint, "rad" or "m".

    Raises:
        ModelError: Names cylinder, joint, position, length and what is allowed.
    """
    stroke, middle = sheet["stroke"], sheet["mid_length"]
    area_a = np.pi / 4 * sheet["bore"] ** 2
    area_b = area_a - np.pi / 4 * sheet["rod"] ** 2
    extended = length - middle + stroke / 2
    volume = np.minimum(
        sheet["dead_volume_a"] + area_a * extended,
        sheet["dead_volume_b"] + area_b * (stroke - extended),
    )
    worst = int(volume.argmin())
    if volume[worst] <= 0.0:
        raise ModelError(
            f"cylinder {name!r} with joint {joint!r} at {position[worst]:.3g} {unit}: its anchors "
            f"are {length[worst]:.4g} m apart; allowed: {middle - stroke / 2:.4g} to "
            f"{middle + stroke / 2:.4g} m (mid_length {middle:g} m, stroke {stroke:g} m)",
            given=name,
        )
    signed = lever * np.sign(lever[np.abs(lever).argmax()])
    zero = int(np.abs(lever).argmin())
    if signed.min() <= _LEAST_LEVER * signed.max():
        raise ModelError(
            f"cylinder {name!r}: its lever arm on joint {joint!r} passes zero near "
            f"{position[zero]:.3g} {unit}, within the range {position[0]:.3g} to "
            f"{position[-1]:.3g} {unit}; allowed: anchors, or a range, by which it keeps one sign",
            given=name,
        )
