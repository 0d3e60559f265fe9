"""``--cluster``: what workers make is what one process makes, also where one of them is lost."""

import contextlib
import dataclasses
import os
import signal
import sys
import warnings

import mitsuba as mi
import numpy as np
import pytest
from cli.test_dataset import RECIPE
from cli.test_stack import channels_of

import potmesil_mi as pm
from potmesil_mi import _cluster, cli
from potmesil_mi.focusing.tiles.forming import focus_by_tiles
from potmesil_mi.focusing.tiles.workers import tiles_elsewhere
from potmesil_mi.stacks.foci import Foci
from potmesil_mi.stacks.forming import Forming
from potmesil_mi.stacks.layouts import plain_files
from potmesil_mi.stacks.plan import StackPlan
from potmesil_mi.stacks.workers import do_elsewhere
from scenes import SCENES, evenly_spread

pytestmark = [pytest.mark.usefixtures("variant_llvm"), pytest.mark.slow]

FOCI = ["--near", "1.5", "--far", "4", "--count", "5", "--circle-map", "--pinhole"]
FIGURE = str(SCENES / "figure11.xml")
SMALL = ["-D", "res=16", "-D", "spp=2"]


@pytest.fixture(scope="module")
def local():
    """The cluster of ``--cluster local``, once for all tests."""
    with _cluster._local() as cluster:
        yield cluster


@pytest.fixture
def address(local):
    return local.scheduler_address


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    path = tmp_path_factory.mktemp("cluster") / "kept.samples"
    evenly_spread((32, 24), 2).save(path)
    return str(path)


@pytest.fixture
def telling(monkeypatch):
    """Has workers tell what they do not, by the fields of what they tell."""
    tell = _cluster.tell
    return lambda **told: monkeypatch.setattr(
        _cluster, "tell", lambda *of: tell(*of)._replace(**told)
    )


def require_same(one, other):
    """All files of two folders, but for when they were written."""
    names, others = (sorted(path.relative_to(of) for path in of.rglob("*")) for of in (one, other))
    assert names == others
    assert any(name.suffix == ".exr" for name in names)
    for name in names:
        if name.suffix == ".json":
            assert (one / name).read_bytes() == (other / name).read_bytes()
        elif name.suffix == ".exr":
            found, expected = channels_of(one / name), channels_of(other / name)
            assert found.keys() == expected.keys()
            for channel, values in expected.items():
                np.testing.assert_allclose(found[channel], values, rtol=1e-5, atol=1e-6)


def stack(folder, source, *more):
    return cli.main(["stack", source, "-o", str(folder / "{:02d}.exr"), *more])


@pytest.fixture(scope="module")
def alone(tmp_path_factory, kept):
    """The files of one process."""
    mi.set_variant("llvm_ad_rgb")
    folder = tmp_path_factory.mktemp("alone")
    assert stack(folder, kept, *FOCI) == 0
    return folder


def test_workers_write_the_files_of_one_process(tmp_path, kept, alone, local, monkeypatch):
    asked = []

    def started(workers):
        asked.append(workers)
        return contextlib.nullcontext(local)

    monkeypatch.setattr(_cluster, "_local", started)
    assert stack(tmp_path, kept, *FOCI, "--cluster", "local:3") == 0
    assert asked == [3]
    require_same(tmp_path, alone)


def test_pictures_of_workers_that_share_no_disk_come_back(
    tmp_path, kept, alone, address, monkeypatch, telling
):
    telling(sees=False)
    written, write = [], Forming.write
    monkeypatch.setattr(Forming, "write", lambda *of: written.append(of[2].index) or write(*of))
    assert stack(tmp_path, kept, *FOCI, "--cluster", address) == 0
    assert sorted(written) == list(range(5))
    require_same(tmp_path, alone)


def test_a_scene_with_its_filter_goes_to_workers(tmp_path, address):
    more = [FIGURE, *SMALL, "--distances", "300", "2000"]
    assert stack(tmp_path / "alone", *more) == 0
    assert stack(tmp_path / "workers", *more, "--cluster", address) == 0
    require_same(tmp_path / "workers", tmp_path / "alone")


@pytest.mark.parametrize("moves", [False, True])
def test_frames_of_workers_are_those_of_one_process(tmp_path, address, moves):
    pull = tmp_path / "pull.toml"
    camera = "[camera]\norigin = [[0, [0, 0, 0]], [2, [5, 0, 0]]]\n" if moves else ""
    pull.write_text(f"frames = 3\n[lens]\nfocus_distance = [[0, 550], [2, 2000]]\n{camera}")
    for name, more in (("alone", []), ("workers", ["--cluster", address])):
        output = ["-o", str(tmp_path / name / "{:02d}.exr")]
        assert cli.main(["animate", FIGURE, str(pull), *SMALL, *output, *more]) == 0
    require_same(tmp_path / "workers", tmp_path / "alone")


def test_a_data_set_of_workers_is_that_of_one_process(tmp_path, address, capsys):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(RECIPE, encoding="utf-8")
    for name, more in (("alone", []), ("workers", ["--cluster", address])):
        assert cli.main(["dataset", str(recipe), "-o", str(tmp_path / name), *more]) == 0
    require_same(tmp_path / "workers", tmp_path / "alone")
    again = ["-o", str(tmp_path / "workers"), "--cluster", address]
    assert cli.main(["dataset", str(recipe), *again]) == 0
    assert "8 of 8 pictures are there already and stay" in capsys.readouterr().err


def test_scenes_are_for_workers_that_share_a_disk(tmp_path, address, capsys, telling):
    telling(sees=False)
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(RECIPE, encoding="utf-8")
    folder = tmp_path / "data"
    assert cli.main(["dataset", str(recipe), "-o", str(folder), "--cluster", address]) == 1
    assert f"--cluster: a data set asks for a disk that all workers share, but they do not see " \
        f"{folder}" in capsys.readouterr().err  # fmt: skip


def test_workers_of_another_version_are_refused(tmp_path, kept, address, capsys, telling):
    telling(version="0.0.9")
    assert stack(tmp_path, kept, *FOCI, "--cluster", address) == 1
    assert "has potmesil_mi 0.0.9, and this is" in capsys.readouterr().err


def test_workers_that_profile_are_warned_of(tmp_path, kept, address, capsys, telling):
    telling(profiles=True)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert stack(tmp_path, kept, "--distances", "2", "--cluster", address) == 0
    assert "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False" in capsys.readouterr().err


def test_tiles_of_workers_are_the_picture_of_one_process(tmp_path, kept, address, monkeypatch):
    for name, more in (("alone", []), ("tiles", ["--tiles", "2x1", "--cluster", address])):
        output = str(tmp_path / name / "picture.exr")
        (tmp_path / name).mkdir()
        assert cli.main(["focus", kept, "--filter", "fade:amount=0.5", "-o", output, *more]) == 0
    require_same(tmp_path / "tiles", tmp_path / "alone")


def test_a_rendered_picture_is_formed_by_tiles_of_workers(tmp_path, address):
    for name, more in (("alone", []), ("tiles", ["--tiles", "1x2", "--cluster", address])):
        (tmp_path / name).mkdir()
        output = str(tmp_path / name / "picture.exr")
        assert cli.main(["render", FIGURE, *SMALL, "-o", output, *more]) == 0
    require_same(tmp_path / "tiles", tmp_path / "alone")


def test_a_cluster_forms_one_picture_by_tiles_alone(tmp_path, kept, address, capsys):
    output = str(tmp_path / "picture.exr")
    assert cli.main(["focus", kept, "-o", output, "--cluster", address]) == 1
    assert f"--cluster={address}: needs --tiles, such as 4x4" in capsys.readouterr().err


# ---------------------------------------------------------------- from Python


def by_filter(folder, kept, address, *filters):
    """The stack of ``alone`` by workers that apply ``filters``, which may do anything."""
    samples = pm.PointSamples.load(kept)
    lenses = Foci(near=1.5, far=4.0, count=5).lenses(samples.lens)
    plan = StackPlan.of(lenses, plain_files([str(folder / "{:02d}.exr")]), how={})
    forming = Forming(pm.FocusSession(samples), filters=filters)
    with _cluster.joined(address, folder) as cluster:
        do_elsewhere(cluster, forming, plan, plan.items)
    return plan


def test_what_cannot_be_made_is_named_and_what_is_there_is_whole(tmp_path, kept, address):
    def fails(picture, lens, pixels_per_mm):
        if lens.focus_distance == 4:
            raise ValueError("too far")
        return picture

    with pytest.raises(_cluster.TaskError, match=r"04\.exr: too far"):
        by_filter(tmp_path, kept, address, fails)
    for path in tmp_path.glob("0*.exr"):
        assert channels_of(path).keys() == {"R", "G", "B"}
    assert not list(tmp_path.glob(".*"))


def test_warnings_of_workers_are_given_here(tmp_path, kept, address):
    def warns(picture, lens, pixels_per_mm):
        warnings.warn("looks odd", stacklevel=1)
        return picture

    with pytest.warns(UserWarning, match="looks odd"):
        by_filter(tmp_path, kept, address, warns)


def test_the_task_of_a_worker_that_is_lost_is_done_by_another(tmp_path, kept, alone, address):
    lost, folder = tmp_path / "lost", tmp_path / "stack"

    def ends_its_worker(picture, lens, pixels_per_mm):
        if lens.focus_distance == 4 and not lost.exists():
            lost.write_text(str(os.getpid()))
            os.kill(os.getpid(), signal.SIGKILL)
        return picture

    plan = by_filter(folder, kept, address, ends_its_worker)
    assert int(lost.read_text()) != os.getpid()
    for item in plan.items:
        name = plan.paths(item)[0].name
        found, expected = channels_of(folder / name), channels_of(alone / name)
        for channel, values in expected.items():
            np.testing.assert_allclose(found[channel], values, rtol=1e-5, atol=1e-6)
    assert not plan.to_do(range(5))


def test_the_tile_of_a_worker_that_is_lost_is_formed_by_another(tmp_path, kept, address):
    lost, here = tmp_path / "lost", os.getpid()

    @dataclasses.dataclass(frozen=True)
    class EndsItsWorker(pm.PointSpreadFunction):
        def table(self, *arguments):
            if os.getpid() != here and not lost.exists():
                lost.write_text(str(os.getpid()))
                os.kill(os.getpid(), signal.SIGKILL)
            return pm.Disc().table(*arguments)

    samples, psf = pm.PointSamples.load(kept), EndsItsWorker()
    with (
        _cluster.joined(address, tmp_path) as cluster,
        tiles_elsewhere(cluster, samples) as doing,
    ):
        picture = focus_by_tiles(samples, None, pm.Layered(), (2, 1), psf, doing=doing)
    assert int(lost.read_text()) != here
    expected = np.array(pm.focus(samples, psf=psf))
    np.testing.assert_allclose(np.array(picture), expected, rtol=0, atol=1e-5)


# ---------------------------------------------------------------- without workers


def test_neighbours_go_to_one_worker_until_it_has_none():
    queues = _cluster._Queues(5, ["a", "b"])
    found = [queues.next_of(worker) for worker in "abaaba"]
    assert found == [0, 2, 1, 4, 3, None]


@pytest.mark.parametrize("where", ["tcp://127.0.0.1:9", "nonsense", "local:0"])
def test_an_address_where_nobody_answers_is_named(tmp_path, kept, capsys, monkeypatch, where):
    monkeypatch.setattr(_cluster, "SECONDS", 0.2)
    assert stack(tmp_path, kept, *FOCI, "--cluster", where) == 1
    assert f"--cluster {where}: no scheduler of Dask answers there" in capsys.readouterr().err


def test_the_extra_is_named(tmp_path, kept, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert stack(tmp_path, kept, *FOCI, "--cluster", "local") == 1
    assert "--cluster: needs Dask: pip install 'potmesil_mi[cluster]'" in capsys.readouterr().err
