"""Paint the pictures that the scenes in this folder use.

Everything is computed from formulas: nothing is downloaded and no photograph is involved, and
running the script again gives the same bytes. Written are

=====================  =======  ==================================================================
mandrill.png           512x512  the face on the cube of Figures 10 to 13
wrinkles.png           512x256  brown, wrinkled skin for a `sphere`, seamless in u
wrinkles_height.png    512x256  its height (16 bit, linear), for the `bumpmap` BSDF
planks.png             512x512  wooden boards, seamless in u and v, for the terrace's table
evening.exr            512x256  the sky of an evening, linear radiance, for an `envmap`
glow.png                  4x64  light of a flame in the wax, bright at the lower end
heart.png              128x128  a heart, for the opening of a lens
=====================  =======  ==================================================================
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SUPERSAMPLING = 2  # pictures are painted this much larger and averaged


# --------------------------------------------------------------------------------------------------
#  Noise
# --------------------------------------------------------------------------------------------------


def lattice(seed: int, *cell: NDArray[np.int64]) -> Array:
    """Return a repeatable number in [0, 1) for every integer lattice cell."""
    h = np.full(cell[0].shape, seed * 0x9E3779B1 & 0xFFFFFFFF, dtype=np.uint64)
    for c in cell:
        h = (h ^ (c.astype(np.uint64) & np.uint64(0xFFFFFFFF))) * np.uint64(0x85EBCA6B)
        h &= np.uint64(0xFFFFFFFF)
        h = (h ^ (h >> np.uint64(13))) * np.uint64(0xC2B2AE35)
        h &= np.uint64(0xFFFFFFFF)
        h ^= h >> np.uint64(16)
    return h.astype(np.float64) / 2.0**32


def noise(*position: Array, seed: int = 0, period: int | None = None) -> Array:
    """Return smooth value noise in [-1, 1]; `period` wraps the first coordinate."""
    position = tuple(np.broadcast_arrays(*position))
    base = [np.floor(p).astype(np.int64) for p in position]
    blend = [
        (t := p - b) * t * t * (t * (6 * t - 15) + 10) for p, b in zip(position, base, strict=True)
    ]
    total = np.zeros(position[0].shape)
    for corner in range(2 ** len(position)):
        weight = np.ones(position[0].shape)
        cell = []
        for axis, (b, f) in enumerate(zip(base, blend, strict=True)):
            step = corner >> axis & 1
            weight = weight * (f if step else 1 - f)
            c = b + step
            cell.append(c % period if axis == 0 and period else c)
        total += weight * lattice(seed, *cell)
    return 2 * total - 1


def smooth(low: float, high: float, x: Array) -> Array:
    """Return 0 below `low`, 1 above `high` and a smooth step between them (either order)."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def mix(a: Array, b: Array, t: Array) -> Array:
    """Blend two colours (or colour images) by the mask `t`."""
    return np.asarray(a) + (np.asarray(b) - np.asarray(a)) * t[..., None]


def rgb(code: str) -> Array:
    """Return the colour `rrggbb`, each component in [0, 1], sRGB."""
    return np.array([int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)])


def canvas(width: int, height: int) -> tuple[Array, Array]:
    """Return supersampled coordinates: x in [0, 1] to the right, y in [0, 1] upwards."""
    w, h = width * SUPERSAMPLING, height * SUPERSAMPLING
    x, y = np.meshgrid((np.arange(w) + 0.5) / w, 1 - (np.arange(h) + 0.5) / h)
    return x, y


def shrink(picture: Array) -> Array:
    """Average the supersampled picture down to its final size."""
    h, w = picture.shape[0] // SUPERSAMPLING, picture.shape[1] // SUPERSAMPLING
    blocks = picture.reshape(h, SUPERSAMPLING, w, SUPERSAMPLING, -1)
    return blocks.mean(axis=(1, 3))


# --------------------------------------------------------------------------------------------------
#  The face
# --------------------------------------------------------------------------------------------------


def ellipse(
    x: Array, y: Array, cx: float, cy: float, rx: float, ry: float, turn: float = 0
) -> Array:
    """Return 0 at the ellipse's centre and 1 on its edge; `turn` is in degrees."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    dx, dy = x - cx, y - cy
    return np.hypot((c * dx + s * dy) / rx, (-s * dx + c * dy) / ry)


def fur(x: Array, y: Array, cx: float, cy: float, seed: int, density: float = 1.0) -> Array:
    """Return strands in [0, 1] that grow away from the point (cx, cy)."""
    dx, dy = x - cx, y - cy
    r = np.hypot(dx, dy)
    a = np.arctan2(dx, dy) + 0.10 * noise(3 * x, 3 * y, seed=seed + 7)
    wide = noise(30 * density * a, 5 * r, seed=seed)
    fine = noise(74 * density * a, 8 * r, seed=seed + 1)
    return np.clip(0.5 + 0.36 * wide + 0.42 * fine, 0, 1)


def mandrill(size: int = 512) -> Array:
    """Paint the face: fur, blue ridged cheeks, a red nose, amber eyes, a yellow beard."""
    x, y = canvas(size, size)
    x, y = 2 * x - 1, 2 * y - 1
    m = np.abs(x)  # the face is symmetric, its fur is not
    r = np.hypot(x, y + 0.02)

    # Leaves behind the head
    leaves = noise(4 * x + 1.5 * y, 7 * y, seed=1) + 0.5 * noise(13 * x, 9 * y - 8 * x, seed=2)
    picture = mix(rgb("0d2b22"), rgb("2f7a4a"), smooth(-0.6, 1.0, leaves))
    picture = mix(picture, rgb("9fc25a"), 0.6 * smooth(0.55, 1.1, leaves))

    # The mane: olive on the head, pale on the cheeks, gold below
    strands = fur(x, y, 0, 0.05, seed=10)
    ragged = 0.10 * (fur(x, y, 0, 0.05, seed=20, density=0.55) - 0.5)
    head = ellipse(x, y, 0, 0.06, 0.90, 0.95)
    mane = mix(rgb("2b2312"), rgb("a3884a"), strands)
    mane = mix(mane, mix(rgb("4d3416"), rgb("d9a648"), strands), smooth(0.25, 0.85, r + ragged))
    picture = mix(picture, mane, smooth(1.03, 0.97, head + 1.4 * ragged))

    # Ears
    ear = ellipse(m, y, 0.77, 0.36, 0.125, 0.19, 14)
    picture = mix(picture, rgb("3a2016"), smooth(1.04, 0.98, ear))
    flesh = mix(rgb("b8705c"), rgb("e7a88c"), 0.5 + 0.5 * noise(9 * x, 9 * y, seed=31))
    picture = mix(picture, flesh, smooth(0.84, 0.76, ear))
    inner = ellipse(m, y, 0.755, 0.35, 0.06, 0.12, 14)
    picture = mix(picture, rgb("52231d"), smooth(1.1, 0.75, inner))

    # Pale tufts on both cheeks, then the beard
    tuft_fur = fur(m, y, 0.25, 0.10, seed=40, density=0.9)
    tuft = ellipse(m, y, 0.53, -0.14, 0.27, 0.40, 12)
    tufts = mix(rgb("8d8878"), rgb("fffaf0"), tuft_fur)
    picture = mix(picture, tufts, smooth(1.06, 0.80, tuft + 0.9 * (tuft_fur - 0.5)))
    beard_fur = fur(x, y, 0, -0.22, seed=50, density=0.9)
    beard = ellipse(x, y, 0, -0.72, 0.44, 0.34)
    gold = mix(rgb("8a3d08"), rgb("ffe066"), beard_fur)
    gold = mix(gold, rgb("f28a1c"), 0.55 * smooth(-0.62, -1.0, y))
    picture = mix(picture, gold, smooth(1.10, 0.86, beard + 0.7 * (beard_fur - 0.5)))

    # Forehead: a dark wedge with a crest
    wedge = ellipse(x, y, 0, 0.62, 0.30, 0.30)
    crest = fur(x, y, 0, 0.28, seed=60, density=0.8)
    dark = mix(rgb("17100c"), rgb("86602c"), crest**1.5)
    picture = mix(picture, dark, smooth(1.06, 0.80, wedge + 0.8 * (crest - 0.5)))

    # The mask of the face
    mask = np.minimum(ellipse(x, y, 0, 0.30, 0.46, 0.26), ellipse(x, y, 0, -0.16, 0.47, 0.50))
    skin = mix(rgb("2a1a1c"), rgb("6b4038"), 0.5 + 0.5 * noise(24 * x, 24 * y, seed=70))
    picture = mix(picture, skin, smooth(1.03, 0.97, mask + 0.05 * (strands - 0.5)))

    # The muzzle, paler, with a mouth and spots for whiskers
    muzzle = ellipse(x, y, 0, -0.50, 0.33, 0.20)
    pale = mix(rgb("b98d80"), rgb("f3d5c0"), smooth(-0.68, -0.40, y))
    pores = smooth(0.55, 0.75, noise(34 * x, 34 * y, seed=71))
    pale = mix(pale, rgb("6c3a33"), 0.6 * pores)
    picture = mix(picture, pale, smooth(1.03, 0.97, muzzle))
    smile = -0.615 + 0.45 * m**2
    lips = np.abs(y - smile) / 0.016
    picture = mix(picture, rgb("2b0d10"), smooth(1.2, 0.7, lips) * smooth(0.29, 0.26, m))
    chin = np.abs(y - smile + 0.03) / 0.018
    picture = mix(picture, rgb("e9a296"), 0.7 * smooth(1.2, 0.5, chin) * smooth(0.20, 0.10, m))

    # Blue cheeks: ridges that run along the muzzle
    cheek = ellipse(m, y, 0.265, -0.09, 0.135, 0.335, -5)
    across = (m - 0.265 + 0.10 * (y + 0.09) - 0.22 * (y + 0.09) ** 2) / 0.135
    ridge = 0.5 + 0.5 * np.cos(2 * np.pi * 3.0 * across)
    ridge = np.clip(ridge + 0.10 * noise(30 * x, 12 * y, seed=80), 0, 1)
    blue = mix(rgb("14206e"), rgb("3f86f0"), smooth(0.0, 0.65, ridge))
    blue = mix(blue, rgb("c4ecff"), smooth(0.78, 1.0, ridge) * smooth(1.0, 0.35, cheek))
    blue = mix(blue, rgb("6a4fc4"), 0.45 * smooth(0.05, -0.35, y))
    picture = mix(picture, rgb("0c0d2c"), smooth(1.12, 1.04, cheek))
    picture = mix(picture, blue, smooth(1.03, 0.97, cheek))

    # The red nose: a bridge that widens into the nostrils
    bridge = 0.060 + 0.050 * smooth(0.25, -0.30, y)
    nose = np.maximum(m / bridge, np.abs(y + 0.05) / 0.36)
    nose = np.minimum(nose, ellipse(x, y, 0, -0.375, 0.195, 0.105))
    nose = np.minimum(nose, ellipse(x, y, 0, 0.30, 0.062, 0.09))
    red = mix(rgb("8e0f14"), rgb("f2362c"), smooth(1.0, 0.2, m / (bridge + 0.06)))
    red = mix(red, rgb("ffb09a"), 0.75 * smooth(0.030, 0.006, m) * smooth(0.36, 0.20, np.abs(y)))
    wrinkle = smooth(0.80, 1.0, np.sin(70 * y + 5 * m / bridge)) * smooth(-0.28, -0.10, y)
    red = mix(red, rgb("6d0a12"), 0.55 * wrinkle * smooth(0.2, 0.7, m / bridge))
    picture = mix(picture, rgb("30060b"), smooth(1.13, 1.04, nose))
    picture = mix(picture, red, smooth(1.03, 0.97, nose))
    shine = ellipse(m, y, 0.085, -0.325, 0.045, 0.018, -15)
    picture = mix(picture, rgb("ffd9cc"), 0.85 * smooth(1.0, 0.5, shine))
    nostril = ellipse(m, y, 0.082, -0.395, 0.052, 0.030, 24)
    picture = mix(picture, rgb("1a0306"), smooth(1.08, 0.90, nostril))

    # Brows and eyes
    brow = ellipse(m, y, 0.195, 0.435, 0.19, 0.075, -8)
    brow_fur = fur(m, y, 0.16, 0.10, seed=90, density=1.3)
    hair = mix(rgb("1b100c"), rgb("b98a4e"), brow_fur**1.4)
    picture = mix(picture, hair, smooth(1.05, 0.85, brow + 0.4 * (brow_fur - 0.5)))
    socket = ellipse(m, y, 0.205, 0.285, 0.125, 0.092, 6)
    lids = mix(rgb("c88a78"), rgb("f6cdb6"), 0.5 + 0.5 * np.cos(26 * socket))
    picture = mix(picture, lids, smooth(1.05, 0.95, socket))
    eye = ellipse(m, y, 0.205, 0.285, 0.092, 0.064, 6)
    picture = mix(picture, rgb("120807"), smooth(1.05, 0.97, eye))
    picture = mix(picture, rgb("f4e6d2"), smooth(0.92, 0.84, eye))
    iris = ellipse(m, y, 0.200, 0.285, 0.057, 0.057)
    rays = 0.5 + 0.5 * noise(11 * np.arctan2(y - 0.285, m - 0.200), 5 * iris, seed=95)
    amber = mix(rgb("7c2f04"), rgb("ffc531"), np.clip(0.25 + 0.75 * rays, 0, 1))
    amber = mix(amber, rgb("3d1402"), smooth(0.75, 1.0, iris))
    inside = smooth(0.98, 0.92, eye)
    picture = mix(picture, amber, smooth(1.04, 0.96, iris) * inside)
    picture = mix(picture, rgb("080404"), smooth(0.52, 0.44, iris) * inside)
    glint = np.hypot((x + 0.022) - np.sign(x) * 0.200, y - 0.307)
    picture = mix(picture, rgb("ffffff"), smooth(0.018, 0.012, glint) * inside)

    # Whiskers: thin arcs from the muzzle
    for k in range(7):
        slope, start = 0.42 - 0.15 * k, -0.43 - 0.022 * k
        t = (m - 0.20) / 0.55
        path = start + slope * (m - 0.20) - 0.30 * (m - 0.20) ** 2
        width = 0.0065 * (1 - 0.8 * np.clip(t, 0, 1))
        line = smooth(1.3, 0.6, np.abs(y - path) / width) * smooth(0, 0.02, t) * smooth(1, 0.97, t)
        picture = mix(picture, rgb("fffdf4"), 0.9 * line)

    return shrink(picture)


# --------------------------------------------------------------------------------------------------
#  Wrinkles, wood, sky
# --------------------------------------------------------------------------------------------------


def wrinkle_height(width: int, height: int) -> Array:
    """Return wrinkles in [0, 1] on the unit sphere, at the texture's (u, v).

    The noise is evaluated in space, on the sphere itself, so there is neither a seam in u nor a
    pinch at the poles.
    """
    u, v = canvas(width, height)
    v = 1 - v  # Mitsuba's first image row has v = 0
    phi, theta = 2 * np.pi * u, np.pi * v
    p = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    warp = [0.32 * noise(*[2.3 * q for q in p], seed=s) for s in (201, 202, 203)]
    p = [q + w for q, w in zip(p, warp, strict=True)]
    total, amplitude, frequency = np.zeros_like(u), 1.0, 4.2
    for octave in range(4):
        crease = np.abs(noise(*[frequency * q for q in p], seed=210 + octave))
        total += amplitude * np.minimum(2.2 * crease, 1) ** 0.8
        amplitude, frequency = 0.48 * amplitude, 2.05 * frequency
    return np.clip(total / 1.75, 0, 1)


def wrinkles(width: int = 512, height: int = 256) -> tuple[Array, Array]:
    """Return the wrinkled skin's colour and its height."""
    h = wrinkle_height(width, height)
    colour = mix(rgb("5a2c12"), rgb("b3703a"), smooth(0.05, 0.75, h))
    colour = mix(colour, rgb("dca566"), 0.6 * smooth(0.70, 1.0, h))
    return shrink(colour), shrink(h[..., None])


def planks(size: int = 512, boards: int = 6) -> Array:
    """Return wooden boards that run along v."""
    x, y = canvas(size, size)
    board = np.floor(x * boards)
    across = x * boards - board
    tone = lattice(300, board.astype(np.int64))
    grain_x = across + 0.10 * noise(2 * y, 3 * across + 9 * board, seed=301, period=2)
    rings = np.sin(
        2
        * np.pi
        * (4 * grain_x + 1.4 * noise(2 * y, 2 * across + 31 * board, seed=302, period=2) + 5 * tone)
    )
    fibre = noise(12 * y, 40 * across + 57 * board, seed=303, period=12)
    wood = mix(rgb("6b4022"), rgb("b8824a"), np.clip(0.5 + 0.26 * rings + 0.26 * fibre, 0, 1))
    wood = wood * (0.74 + 0.42 * tone[..., None])
    gap = np.minimum(across, 1 - across)
    return shrink(mix(wood, rgb("150a06"), smooth(0.028, 0.010, gap)))


SUN = (-0.72, 0.30, 0.62)  # direction of the sun, y up


def evening(width: int = 512, height: int = 256) -> Array:
    """Return the radiance of an evening sky with a low sun, over warm ground.

    Mitsuba's `envmap` puts +y at the top row; the middle column looks along +z and the first one
    along -z.
    """
    u, v = canvas(width, height)
    azimuth, elevation = 2 * np.pi * u, np.pi * (v - 0.5)
    x = np.sin(azimuth) * np.cos(elevation)
    y = np.sin(elevation)
    z = -np.cos(azimuth) * np.cos(elevation)

    sun = np.array(SUN) / np.linalg.norm(SUN)
    away = np.degrees(np.arccos(np.clip(x * sun[0] + y * sun[1] + z * sun[2], -1, 1)))
    up = np.clip(y, 0, 1)

    zenith, middle = np.array([0.10, 0.17, 0.36]), np.array([0.30, 0.34, 0.55])
    horizon = np.array([0.85, 0.52, 0.42])
    sky = mix(horizon, middle, smooth(0.0, 0.24, up))
    sky = mix(sky, zenith, smooth(0.15, 0.9, up))
    glow = np.exp(-((away / 34) ** 2))
    sky = sky + glow[..., None] * np.array([1.5, 0.80, 0.32])
    bars = noise(6 * u * 2, 26 * v, seed=401, period=12) + 0.6 * noise(
        48 * u, 60 * v, seed=402, period=48
    )
    cloud = smooth(0.05, 0.9, bars) * smooth(0.02, 0.12, up) * smooth(0.62, 0.25, up)
    lit = np.array([0.75, 0.45, 0.42]) + glow[..., None] * np.array([2.2, 1.3, 0.7])
    sky = mix(sky, lit, 0.55 * cloud)
    disc = smooth(11.0, 5.0, away)  # degrees: a sun in haze, whose caustics need few samples
    sky = sky + disc[..., None] * np.array([10.0, 6.6, 3.6])

    ground = mix(np.array([0.22, 0.15, 0.10]), np.array([0.11, 0.11, 0.09]), smooth(-0.4, 0, y))
    zero = np.zeros_like(u)
    for k, (base, tint) in enumerate([(0.052, (0.27, 0.25, 0.36)), (0.022, (0.10, 0.12, 0.14))]):
        hills = base + 0.022 * noise(14 * u, zero, seed=403 + k, period=14)
        hills += 0.008 * noise(44 * u, zero, seed=413 + k, period=44)
        slope = np.array(tint) + glow[..., None] * np.array([0.30, 0.16, 0.08])
        sky = mix(sky, slope, smooth(0.003, -0.003, y - hills))
    return shrink(mix(sky, ground, smooth(0.004, -0.004, y)))


# --------------------------------------------------------------------------------------------------
#  Glow and heart
# --------------------------------------------------------------------------------------------------


def glow(width: int = 4, height: int = 64) -> Array:
    """Return how a candle glows, whose rim is at the lower end."""
    _, y = canvas(width, height)
    light = np.exp(-y / 0.16)[..., None]
    return shrink(light ** np.array([0.75, 1.0, 1.5]) * np.array([0.95, 0.62, 0.3]))


def heart(size: int = 128) -> Array:
    """Return a white heart on black: two half circles above, a point below."""
    u, v = canvas(size, size)
    x, y = np.abs(4.2 * u - 2.1), 4.2 * v - 3.1
    within = np.minimum(x / 2, 1)
    inside = (
        (x < 2) & (y < np.sqrt(1 - (2 * within - 1) ** 2)) & (y > -3 * np.sqrt(1 - np.sqrt(within)))
    )
    return shrink(inside[..., None] * np.ones(3))


# --------------------------------------------------------------------------------------------------
#  Files
# --------------------------------------------------------------------------------------------------


def write_png(path: Path, picture: Array, levels: type = np.uint8, srgb: bool = True) -> None:
    """Write values in [0, 1] without any further conversion."""
    top = np.iinfo(levels).max
    bitmap = mi.Bitmap(np.round(np.clip(picture, 0, 1) * top).astype(levels))
    bitmap.set_srgb_gamma(srgb)
    bitmap.write(str(path))


def write_exr(path: Path, radiance: Array) -> None:
    """Write linear radiance as half floats."""
    bitmap = mi.Bitmap(radiance.astype(np.float32), mi.Bitmap.PixelFormat.RGB)
    bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float16, False).write(str(path))


def write_wrinkles(folder: Path) -> None:
    """Write the wrinkled skin: colour and height."""
    colour, height = wrinkles()
    write_png(folder / "wrinkles.png", colour)
    write_png(folder / "wrinkles_height.png", height, levels=np.uint16, srgb=False)


JOBS: dict[str, Callable[[Path], None]] = {
    "mandrill": lambda folder: write_png(folder / "mandrill.png", mandrill()),
    "wrinkles": write_wrinkles,
    "planks": lambda folder: write_png(folder / "planks.png", planks()),
    "glow": lambda folder: write_png(folder / "glow.png", glow()),
    "heart": lambda folder: write_png(folder / "heart.png", heart()),
    "evening": lambda folder: write_exr(folder / "evening.exr", evening()),
}


def main() -> None:
    """Read the command line and write the pictures asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"what to paint: {', '.join(JOBS)} (default: all)"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path(__file__).resolve().parent / "textures",
        metavar="FOLDER",
        help="where to write the files (default: textures/ beside this script)",
    )
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(JOBS))
    if unknown:
        parser.error(f"unknown name {unknown[0]!r}; choose from {', '.join(JOBS)}")

    mi.set_variant("scalar_rgb")
    arguments.output.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or JOBS:
        JOBS[name](arguments.output)


if __name__ == "__main__":
    main()
