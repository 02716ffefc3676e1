"""A machine and its motion in space, for log viewers: links, their poses, joint efforts."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """The links of a machine and their poses over a recording."""

    urdf: str  #: The machine as a URDF with the link names of `links`; meshes are `data:` URIs
    links: tuple[str, ...]  #: Names, the world first
    parents: tuple[int, ...]  #: Index of the parent of each link; -1 for the world
    rows: np.ndarray  #: Rows of the recording to which the poses belong, (k,)
    positions: np.ndarray  #: Positions of links in their parents' frames [m], (k, links, 3)
    quaternions: np.ndarray  #: Rotations of links to their parents, w x y z, (k, links, 4)
    #: Torque or force of the drives at a joint [N m or N] by joint, (n,) each.
    efforts: Mapping[str, np.ndarray] = field(default_factory=dict)
