"""``potmesil live``: what it opens, and how it ends."""

import json
import os
import re
import signal
import subprocess
import sys
import urllib.request
import webbrowser

import numpy as np
import pytest

from potmesil_mi import cli
from potmesil_mi._image import write_picture
from scenes import SCENES, evenly_spread

pytest.importorskip("aiohttp")
pytestmark = pytest.mark.usefixtures("variant_llvm")

ADDRESS = r"http://127\.0\.0\.1:\d+/[\w-]{32}/"
SHORT = ["--no-browser", "--seconds", "0.1"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "kept.samples"
    evenly_spread((24, 16), 2).save(path)
    return str(path)


def live(*arguments):
    return cli.main(["live", *arguments])


def test_samples_are_shown_for_as_long_as_is_said(kept, capsys):
    assert live(kept, *SHORT) == 0
    said = capsys.readouterr()
    assert re.fullmatch(ADDRESS, said.out.strip())
    assert said.err.strip() == "potmesil: the page is there for 0.1 s"


def test_a_scene_is_sampled_and_its_samples_kept(tmp_path, capsys):
    path = tmp_path / "figure11.samples"
    options = ["-D", "res=16", "-D", "spp=2", "--samples", str(path)]
    assert live(str(SCENES / "figure11.xml"), *options, *SHORT) == 0
    assert path.is_file()
    assert live(str(path), "--f-number", "8", "--method", "paper", *SHORT) == 0


def test_a_picture_with_its_depth_is_shown(tmp_path):
    path = str(tmp_path / "sharp.exr")
    depth = np.tile(np.linspace(1, 3, 24), (16, 1))
    write_picture(np.full((16, 24, 3), 0.5), path, maps={"Z": depth})
    lens = ["--fov", "40", "--f-number", "2", "--focus-at", "50%,50%", "--units", "m"]
    assert live(path, "--depth-kind", "z", *lens, *SHORT) == 0


def test_the_browser_is_opened_at_the_address(kept, capsys, monkeypatch):
    addresses = []
    monkeypatch.setattr(webbrowser, "open", addresses.append)
    assert live(kept, "--seconds", "0.1", "--json") == 0
    assert [json.loads(capsys.readouterr().out)["address"]] == addresses


def test_ctrl_c_ends_it_in_order_and_as_other_commands(kept):
    words = [sys.executable, "-m", "potmesil_mi", "live", kept, "--no-browser"]
    ended = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ)
    )
    address = ended.stdout.readline().strip()
    assert re.fullmatch(ADDRESS, address)
    assert b"viewer.css" in urllib.request.urlopen(address, timeout=10).read()
    ended.send_signal(signal.SIGINT)
    _, said = ended.communicate(timeout=30)
    assert ended.returncode == 130
    assert said.splitlines()[-1] == "potmesil: interrupted"


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--port", "65536"], "--port=65536: must be 0 to 65535"),
        (["--seconds", "0"], "--seconds=0.0: must be > 0"),
        (["--spp", "4"], "--spp=4: is for a scene"),
        (["--f-number", "inf"], "lens: is a pinhole"),
        (["--filter", "glow"], "glow"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(kept, options, text, capsys):
    assert live(kept, *SHORT, *options) == 1
    assert text in capsys.readouterr().err


def test_without_the_extra_a_line_says_what_to_install(kept, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    assert live(kept, *SHORT) == 1
    assert "pip install 'potmesil_mi[interactive]'" in capsys.readouterr().err
