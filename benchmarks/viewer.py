"""How quickly the viewer answers: a click, by the full picture; a drag, by pictures a second.

The page of `potmesil live` in headless Chromium, and the server, on this machine. A click is at
another place each time; the time ends when the picture is on the canvas. While one drags the slider
of the focus, the small pictures on the canvas are counted. Seconds of processors are those of the
server alone.

    python benchmarks/viewer.py [SAMPLES | SCENE [OPTIONS OF potmesil live]]
"""

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import browser as browsers

CLICKS = 20
DRAG = 4.0  # seconds
PLACES = [(0.3 + 0.05 * (i % 9), 0.35 + 0.04 * (i * 7 % 11)) for i in range(CLICKS)]

# Counts pictures as they are drawn; to ask the page again and again would take processors from it.
COUNT = """() => {
  const canvas = document.querySelector("canvas");
  window.drawn = [];
  new MutationObserver(() => {
    drawn.push([performance.now(), canvas.dataset.small]);
    window.next?.();
  }).observe(canvas, { attributes: true, attributeFilter: ["data-shown"] });
  canvas.addEventListener("click", () => (window.clicked = performance.now()), true);
}"""


def seconds_of(process):
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def settled(page):
    """Wait until nothing is underway, and the full picture is shown."""
    page.wait_for_selector("canvas[data-small=false]")
    page.wait_for_selector("section[aria-busy=false]")
    page.wait_for_timeout(300)


def clicks(page, process):
    box = page.locator("canvas").first.bounding_box()
    took, used = [], []
    for x, y in PLACES:
        began = seconds_of(process)
        page.evaluate("() => { window.shown = new Promise((done) => { window.next = done; }); }")
        page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
        took.append(page.evaluate("shown.then(() => drawn.at(-1)[0] - clicked)") / 1000)
        page.wait_for_timeout(100)
        used.append(seconds_of(process) - began)
    return took, used


def drag(page, process, label):
    box = page.get_by_label(label, exact=True).bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 8, middle)
    page.mouse.down()
    page.wait_for_timeout(500)
    page.evaluate("drawn.length = 0")
    began, used, step = time.perf_counter(), seconds_of(process), 0
    while time.perf_counter() - began < DRAG:
        step += 1
        share = abs((step * 0.01) % 2 - 1)
        page.mouse.move(box["x"] + 8 + share * (box["width"] - 16), middle)
        page.wait_for_timeout(16)
    count = page.evaluate("drawn.filter(([, small]) => small === 'true').length")
    took, used = time.perf_counter() - began, seconds_of(process) - used
    page.mouse.up()
    settled(page)
    print(
        f"drag of {label}: {count / took:.1f} small pictures a second, "
        f"{used / max(count, 1):.3f} s of processors each"
    )


def main():
    import tempfile

    given = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        if not given:
            given = [f"{folder}/figure11.samples"]
            command = "render example:figure11 -D res=512 --spp 16 -o {0}/p.png --samples {1}"
            words = command.format(folder, given[0]).split()
            subprocess.run([sys.executable, "-m", "potmesil_mi", *words, "-q"], check=True)
        words = [sys.executable, "-m", "potmesil_mi", "live", *given, "--no-browser"]
        server = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        try:
            address = server.stdout.readline().strip()
            with browsers.started() as browser, browsers.opened(browser) as page:
                page.goto(address)
                settled(page)
                page.evaluate(COUNT)
                for name in ("the first clicks", "the same again"):
                    took, used = clicks(page, server.pid)
                    print(
                        f"{name}: median {statistics.median(took):.3f} s from click to picture, "
                        f"quickest {min(took):.3f} s, slowest {max(took):.3f} s; "
                        f"{statistics.median(used):.3f} s of processors"
                    )
                for label in ("Focus", "Aperture"):
                    drag(page, server.pid, label)
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
