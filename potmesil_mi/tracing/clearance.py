"""How far from a surface a ray begins or ends, so as not to meet that surface again.

Mitsuba's own ``spawn_ray`` keeps at least 9e-5 scene units, which is far in a scene of a
thousandth of a unit. Here it is in proportion to the numbers that single precision rounds.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def clearance(point: mi.Point3f, distance: mi.Float) -> mi.Float:
    """How far to keep from a surface at ``point``, ``distance`` away from where a ray began."""
    return mi.math.RayEpsilon * dr.maximum(dr.max(dr.abs(point)), distance)


def ray_from(hit: mi.SurfaceInteraction3f, direction: mi.Vector3f, distance: mi.Float) -> mi.Ray3f:
    """The ray that leaves ``hit`` in ``direction``; ``distance`` is as in :func:`clearance`."""
    offset = dr.mulsign(clearance(hit.p, distance), dr.dot(hit.n, direction))
    return mi.Ray3f(hit.p + offset * hit.n, direction, hit.time, hit.wavelengths)
