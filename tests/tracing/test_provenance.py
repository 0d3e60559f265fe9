"""What samples of a scene say of how they were taken."""

import mitsuba as mi
import pytest

import potmesil_mi as pm
from potmesil_mi._version import package_version
from potmesil_mi.samples.provenance import widest_of
from potmesil_mi.tracing.provenance import plugin_name
from scenes import still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")


@pytest.mark.parametrize("name", ["path", "direct", "volpath", "volpathmis", "prb", "prb_basic"])
def test_an_integrator_is_called_what_scenes_call_it(name):
    assert plugin_name(mi.load_dict({"type": name})) == name


def test_samples_say_by_what_they_were_taken():
    scene = still_life()
    sampling = pm.Sampling(refine=0, layers=1, overscan=0, focus_range=(1, 3), virtual_depth=False)
    samples = pm.render_samples(scene, spp=2, seed=7, sampling=sampling)
    assert samples.provenance == {
        "version": package_version(),
        "mitsuba": mi.__version__,
        "variant": mi.variant(),
        "integrator": plugin_name(scene.integrator()),
        "seed": 7,
        "spp": 2,
        "pattern": "sampler",
        "refine": 0,
        "layers": 1,
        "overscan": 0,
        "focus_range": "1.0/3.0",
        "virtual_depth": 0,
        **widest_of(samples.lens),
    }
