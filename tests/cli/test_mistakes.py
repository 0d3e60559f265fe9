"""Mistakes of newcomers: each ends in a line that says what is wrong, or in the right picture."""

import subprocess
import sys

import numpy as np
import OpenEXR
import pytest
from cli.test_choosing_focus import IN_CENTIMETERS

import potmesil_mi as pm
from potmesil_mi import cli
from scenes import evenly_spread

pytestmark = [
    pytest.mark.usefixtures("variant_llvm"),
    pytest.mark.filterwarnings("always::potmesil_mi._warnings.FocusWarning"),
]

LENS = ["--units", "cm", "--f-number", "0.5", "--focus-on", "cup"]


@pytest.fixture
def table(tmp_path, monkeypatch):
    """A scene in centimetres, in the folder at hand."""
    monkeypatch.chdir(tmp_path)
    text = IN_CENTIMETERS.replace("<integrator", '<default name="spp" value="4"/><integrator')
    (tmp_path / "cup.xml").write_text(
        '<scene version="3.0.0"><default name="size" value="20"/><shape type="sphere" id="cup">'
        '<point name="center" x="-25" y="0" z="120"/><float name="radius" value="$size"/></shape>'
        "</scene>"
    )
    cup = text[
        text.index('<shape type="sphere" id="cup">') : text.index('<shape type="sphere" id="jug">')
    ]
    text = text.replace(cup, '<include filename="cup.xml"/>')
    (tmp_path / "table.xml").write_text(
        text.replace('value="4"/></sampler', 'value="$spp"/></sampler')
    )
    return tmp_path / "table.xml"


def said(capsys):
    return capsys.readouterr().err


def test_a_file_of_another_kind_is_told_with_the_command_that_takes_it(table, capsys):
    evenly_spread((8, 6), 1).save("a.samples")
    evenly_spread((8, 6), 1).save("deep.exr")
    (table.parent / "a.png").write_bytes(b"")
    for command, source, text in [
        (
            "render",
            "a.samples",
            "a.samples: holds samples, and a scene is needed; `potmesil focus`",
        ),
        ("render", "deep.exr", "deep.exr: holds samples, and a scene is needed"),
        ("render", "a.png", "a.png: holds a picture, and a scene is needed"),
        ("render", "nosuch.xml", "nosuch.xml: there is no such file"),
        ("render", "-", "-: there is no such file"),
        ("compare", "a.samples", "a.samples: holds samples"),
        ("focus", "table.xml", "table.xml: is a scene; `potmesil render --samples` takes its"),
    ]:
        assert cli.main([command, source, "-o", "b.png" if command != "compare" else "b/"]) == 1
        assert f"potmesil: error: {text}" in said(capsys)


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("ssp", "--define=ssp: the scene has no $ssp; did you mean spp?"),
        ("sise", "--define=sise: the scene has no $sise; did you mean size?"),
        ("width", "--define=width: the scene has no $width; it has spp, size"),
    ],
)
def test_a_parameter_that_the_scene_does_not_have_is_told_in_a_line(table, capsys, key, text):
    assert cli.main(["render", "table.xml", "-D", f"{key}=3", *LENS, "-o", "a.png"]) == 1
    assert said(capsys) == f"potmesil: error: {text}\n"


def test_a_parameter_without_a_value_is_told_with_the_option_that_gives_it(table, capsys):
    table.write_text(table.read_text().replace('<default name="spp" value="4"/>', ""))
    assert cli.main(["render", "table.xml", *LENS, "-o", "a.png"]) == 1
    assert said(capsys) == "potmesil: error: table.xml: $spp has no value; -D spp=... gives it\n"


def test_the_same_picture_twice_is_refused(table, capsys):
    assert cli.main(["render", "table.xml", *LENS, "-o", "a.png", "-o", "./a.png"]) == 1
    assert "--output='./a.png': must be given once" in said(capsys)


def test_a_share_of_the_picture_without_its_sign_is_told_where_it_shows_nothing(table, capsys):
    lens = ["--units", "cm", "--f-number", "0.5", "--focus-at", "0.5,0.5"]
    assert cli.main(["render", "table.xml", *lens, "-o", "a.png"]) == 0
    text = (
        "focus_at: x=0.5, y=0.5: nothing is there, so that the lens is focused at infinity; shares"
    )
    assert text in said(capsys)


def test_info_of_a_pinhole_asks_for_no_focus(table, capsys):
    assert cli.main(["info", "table.xml", "--units", "cm"]) == 0
    assert said(capsys) == ""


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--f-number", "0.1"], "f_number=0.1: is wider than f/0.5, than which no lens"),
        (["--focal-length", "0.05"], "the focal length for 0.05 mm (--focal-length"),
    ],
)
def test_a_lens_that_there_is_not_is_told(table, capsys, options, text):
    assert cli.main(["render", "table.xml", *LENS, *options, "-o", "a.png"]) == 0
    assert text in said(capsys)


@pytest.mark.parametrize(
    ("given", "meant"), [("--fstop", "--f-number"), ("--focus", "--focus-distance")]
)
def test_what_others_call_an_option_is_known(table, capsys, given, meant):
    with pytest.raises(SystemExit):
        cli.main(["render", "table.xml", given, "2", "-o", "a.png"])
    assert f"did you mean {meant}?" in said(capsys)


def test_a_depth_of_eight_bits_is_told_to_have_steps(table, capsys):
    import OpenImageIO as oiio

    for name, kind in (("8.png", np.uint8), ("16.png", np.uint16)):
        image = oiio.ImageOutput.create(name)
        image.open(name, oiio.ImageSpec(8, 6, 1, np.dtype(kind).name))
        image.write_image(np.full((6, 8, 1), 100, kind))
        image.close()
    image = oiio.ImageOutput.create("a.exr")
    image.open("a.exr", oiio.ImageSpec(8, 6, 3, "float"))
    image.write_image(np.ones((6, 8, 3), np.float32))
    image.close()
    of = ["--depth-kind", "z", "--depth-scale", "2", "--fov", "40", "--units", "cm"]
    lens = ["--f-number", "2", "--focus-distance", "200", "-o", "b.exr"]
    assert cli.main(["focus", "a.exr", "--depth", "8.png", *of, *lens]) == 0
    assert "depth: has 8 bits, and so steps of 2, which show" in said(capsys)
    assert cli.main(["focus", "a.exr", "--depth", "16.png", *of, *lens]) == 0
    assert "bits" not in said(capsys)


def test_windows_line_ends_a_byte_order_mark_and_names_of_all_kinds_are_read(table, capsys):
    text = "\ufeff" + table.read_text().replace("\n", "\r\n")
    folder = table.parent / "Übung mit Platz"
    folder.mkdir()
    cup = (table.parent / "cup.xml").read_text().replace('"cup"', '"my cup"')
    (folder / "cup.xml").write_text(cup)
    (folder / "Szene äöü.xml").write_bytes(text.encode())
    lens = [*LENS[:-1], "my cup", "-o", str(folder / "Bild ä.exr")]
    kept = str(folder / "Proben ü.samples")
    assert cli.main(["render", str(folder / "Szene äöü.xml"), *lens, "--samples", kept]) == 0
    assert 100 < pm.PointSamples.load(kept).lens.focus_distance < 120
    with OpenEXR.File(str(folder / "Bild ä.exr")) as file:
        assert np.isfinite(file.channels()["RGB"].pixels).all()
    assert "warning" not in said(capsys)


def test_whoever_reads_the_first_line_alone_sees_no_error():
    code = "import sys; from potmesil_mi import cli; sys.exit(cli.main(['dof', '--json']))"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        process.stdout.close()
        error = process.stderr.read()
    assert (process.returncode, error) == (cli.BROKEN_PIPE, b"")


def test_dof_speaks_of_the_unit_that_it_is_told(capsys):
    assert cli.main(["dof", "--units", "cm", "--focus-distance", "1.2m"]) == 0
    out = capsys.readouterr().out
    assert "(cm)" in out
    assert " 120 " in out
