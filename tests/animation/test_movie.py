"""Movies of frames in files."""

import subprocess

import numpy as np
import pytest

from potmesil_mi import cli
from potmesil_mi._image import write_picture
from potmesil_mi.animation import movie

pytest.importorskip("imageio_ffmpeg")
pytestmark = pytest.mark.usefixtures("variant_llvm")


def frames(tmp_path, size=(32, 48), ending=".png", count=5):
    """Files of frames that grow brighter from left to right, each more than the one before."""
    paths = []
    for number in range(count):
        picture = np.ones((*size, 3)) * np.linspace(0, (number + 1) / count, size[1])[:, None]
        paths.append(tmp_path / f"f_{number}{ending}")
        write_picture(picture, paths[-1])
    return paths


def read(path, size):
    """The frames of a movie, (N, H, W, 3), and what ffmpeg says of it."""
    command = [movie.require_extra(), "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    run = subprocess.run(command, capture_output=True, check=True)
    return np.frombuffer(run.stdout, np.uint8).reshape(-1, *size, 3), run.stderr.decode()


@pytest.mark.parametrize("ending", [".png", ".exr"])
@pytest.mark.parametrize("kind", movie.MOVIES)
def test_a_movie_shows_its_frames_in_srgb(tmp_path, ending, kind):
    paths = frames(tmp_path, ending=ending)
    movie.write_movie(tmp_path / f"a{kind}", paths, 25)
    shown, about = read(tmp_path / f"a{kind}", (32, 48))
    assert len(shown) == 5
    assert ", 25 fps," in about
    light = np.linspace(0, 1, 48)
    srgb = np.where(light < 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    assert np.abs(shown[-1].astype(float) - 255 * srgb[:, None]).max() < 10
    assert (np.diff(shown.mean(axis=(1, 2, 3))) > 3).all()


def test_pictures_of_odd_size_get_one_more_row_and_column(tmp_path):
    movie.write_movie(tmp_path / "a.mp4", frames(tmp_path, (31, 47)), 24)
    shown, _ = read(tmp_path / "a.mp4", (32, 48))
    assert np.abs(np.diff(shown[:, -2:].astype(int), axis=1)).max() < 4


def test_pictures_of_several_sizes_make_no_movie_and_leave_nothing(tmp_path):
    paths = frames(tmp_path)
    write_picture(np.ones((32, 40, 3)), paths[3])
    with pytest.raises(ValueError, match=r"f_3.png: has 40x32 pixels, must have 48x32"):
        movie.write_movie(tmp_path / "a.mp4", paths, 24)
    assert sorted(tmp_path.iterdir()) == sorted(paths)


def test_what_ffmpeg_cannot_write_is_named_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(movie, "QUALITY", "best")
    with pytest.raises(OSError, match=r"a.mp4: ffmpeg could not write it: .+") as error:
        movie.write_movie(tmp_path / "a.mp4", frames(tmp_path), 24)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "a.mp4").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ([], "a.mp4': a movie is made of frames, which must have names, too"),
        (["-o", "f_{}.png", "--shard", "1/2"], "a.mp4': a movie is of all frames"),
        (["-o", "f_{}.png", "--frames", "1"], "a.mp4': a movie is of all frames"),
    ],
)
def test_a_movie_that_cannot_be_is_refused_before_the_first_frame(
    tmp_path, monkeypatch, capsys, more, message
):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["animate", "absent.samples", "absent.toml", "-o", "a.mp4", *more]) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
