"""Files of pictures as other programs write them."""

from __future__ import annotations

import numpy as np
import OpenEXR
import OpenImageIO as oiio


def write_exr(path, *parts, **attributes):
    """Parts are mappings of channels; the attributes are of each."""
    made = [
        OpenEXR.Part(
            {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **attributes},
            {name: np.ascontiguousarray(values) for name, values in part.items()},
            name=f"part{i}",
        )
        for i, part in enumerate(parts)
    ]
    with OpenEXR.File(made) as file:
        file.write(str(path))
    return path


def write_image(path, values, **attributes):
    """A picture as OpenImageIO writes it, of the type of the array."""
    values = values.reshape(*values.shape[:2], -1)
    kind = str(values.dtype).replace("float32", "float")
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind)
    for name, value in attributes.items():
        spec.attribute(name, value)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    output.write_image(np.ascontiguousarray(values))
    output.close()
    return path


def write_deep(path, pixels, names, **attributes):
    """``pixels`` (H, W) are lists of samples, each with a number for each channel of ``names``."""
    height, width = len(pixels), len(pixels[0])
    channels = {}
    for i, name in enumerate(names):
        column = np.empty((height, width), dtype=object)
        for row in range(height):
            for at in range(width):
                column[row, at] = np.array([of[i] for of in pixels[row][at]], np.float32)
        channels[name] = column
    kind = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    header = {**kind, **attributes}
    with OpenEXR.File([OpenEXR.Part(header, channels, name="rgba")]) as file:
        file.write(str(path))
    return path
