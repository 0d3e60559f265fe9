"""Living pictures: bytes, dB from ``pm.focus`` at foci that are not kept, frames a second.

    python benchmarks/living.py terrace.samples terrace.html
    python benchmarks/living.py lamps.samples lamps.html

of samples that ``potmesil render --samples`` kept, and of the page that ``potmesil living`` made of
them. At the widest and at the next aperture 20 foci are drawn, none of which is one that the page
keeps; what its canvas shows there, decoded and blended by the browser, is compared with a picture
that is formed anew. In front of the camera a near edge covers what is far in both scenes. Frames
are counted while the focus goes from near to far and back, in a headless Chromium whose WebGL2 is
drawn by software (SwiftShader); a GPU is quicker. First paint is what the browser calls so, from
the beginning of the navigation.
"""

import argparse
import base64
import io
import statistics
import sys
from pathlib import Path

import numpy as np
from PIL import Image

import potmesil_mi as pm
from potmesil_mi._image import in_srgb
from potmesil_mi.living.page import read_pictures

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import browser as browsers

FOCI = 20

SHOWN = """([place, level]) => {
    const { dataset } = document.querySelector("canvas");
    return Math.abs(dataset.place - place) < 1e-3 && dataset.level == level;
}"""

FRAMES = """() => new Promise((done) => {
    const slider = document.querySelector("input");
    const canvas = document.querySelector("canvas");
    const began = performance.now();
    const drawn = new Set();
    let frames = 0;
    const step = (now) => {
        const seconds = (now - began) / 1000;
        if (seconds > 6) return done([frames / seconds, drawn.size / seconds]);
        const place = Math.abs(((seconds / 3) % 2) - 1); // Near to far in 3 s, and back.
        slider.value = 1000 * place;
        slider.dispatchEvent(new Event("input"));
        drawn.add(canvas.dataset.place);
        frames += 1;
        requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
})"""

PAINT = """() => {
    const [first] = performance.getEntriesByName("first-contentful-paint");
    return first ? first.startTime : NaN;
}"""


def places_between(level, rng):
    """Places of which none is, or is next to, one that is kept."""
    found = []
    while len(found) < FOCI:
        place = round(float(rng.uniform(0, 1)), 3)
        if min(abs(place - kept) for kept in level.places) > 2e-3:
            found.append(place)
    return found


def shown(page, place):
    slider = page.locator("input").first
    slider.fill(str(round(1000 * place)))
    page.wait_for_function(SHOWN, arg=[place, int(page.locator("input").nth(1).input_value())])
    page.wait_for_timeout(50)
    url = page.locator("canvas").evaluate("canvas => canvas.toDataURL()")
    return np.array(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGB"))


def measured(page, samples, picture, number):
    """PSNR at foci between those that are kept, at an aperture."""
    level = picture.levels[number]
    if len(picture.levels) > 1:
        page.locator("input").nth(1).fill(str(number))
        page.wait_for_timeout(500)
    found = []
    session = pm.FocusSession(samples)
    for place in sorted(places_between(level, np.random.default_rng(number))):
        distance = picture.focus_range.distance_at(place)
        lens = samples.lens.replace(f_number=level.f_number, focus_distance=distance)
        expected = in_srgb(np.array(session.focus(lens)), "8").astype(float)
        error = np.mean(((shown(page, place) - expected) / 255) ** 2)
        found.append(float(-10 * np.log10(error)))
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("samples")
    parser.add_argument("page", type=Path)
    parser.add_argument("--levels", type=int, nargs="+", default=[0, 1])
    options = parser.parse_args()
    samples = pm.PointSamples.load(options.samples)
    (picture,) = read_pictures(options.page)
    kept = [len(level.places) for level in picture.levels]
    print(
        f"{options.page.name}: {options.page.stat().st_size / 1e6:.2f} MB, "
        f"{picture.size[0]}x{picture.size[1]}, {sum(kept)} pictures {kept}; its maker measured "
        f"{picture.worst:.1f} dB at worst, {picture.median:.1f} at the median of {picture.measured}"
    )
    with browsers.started() as browser, browsers.opened(browser, height=900) as page:
        for _ in range(2):  # What the browser itself takes to start does not count.
            page.goto(options.page.resolve().as_uri())
        page.wait_for_selector("canvas[data-place]")
        print(f"first paint after {page.evaluate(PAINT):.0f} ms")
        page.evaluate(FRAMES)  # Pictures are decoded.
        steps, drawn = page.evaluate(FRAMES)
        print(f"{steps:.0f} frames a second, {drawn:.0f} of them with another picture")
        for number in options.levels:
            found = measured(page, samples, picture, number)
            print(
                f"f/{picture.levels[number].f_number:g}: {min(found):.1f} dB at worst, "
                f"{statistics.median(found):.1f} at the median of {len(found)} foci"
            )
        assert not page.errors, page.errors


if __name__ == "__main__":
    main()
