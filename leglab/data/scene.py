"""A machine and its motion in space, for log viewers: links, where they are, and their efforts."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A surface of a link.

    Attributes:
        link: Index of the link in `Scene.links`.
        vertices: In the frame of the link [m], (v, 3).
        faces: Indices of the corners of its triangles, (f, 3).
        color: Red, green, blue and opacity in [0, 1], (4,).
    """

    link: int
    vertices: np.ndarray
    faces: np.ndarray
    color: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """The links of a machine and their poses over a recording.

    Attributes:
        urdf: The machine as a URDF whose links are called as here; meshes are `data:` URIs.
        links: Names, the world first.
        parents: Index of the parent of each link; that of the world is -1.
        rows: Samples of the recording at which the poses stand, (k,).
        positions: Of the links in the frames of their parents [m], (k, links, 3).
        quaternions: Of the links in the frames of their parents, w x y z, (k, links, 4).
        efforts: Torque or force of the drives at a joint [N m or N] by joint, (n,) each.
        meshes: Surfaces, those that never change among them.
    """

    urdf: str
    links: tuple[str, ...]
    parents: tuple[int, ...]
    rows: np.ndarray
    positions: np.ndarray
    quaternions: np.ndarray
    efforts: Mapping[str, np.ndarray] = field(default_factory=dict)
    meshes: tuple[Mesh, ...] = ()
