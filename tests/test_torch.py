"""The layer of torch: gradients against differences, and what it refuses.

It is not in a folder ``torch``, as its wing is: that would be a module ``torch`` to the tests.
"""

import subprocess
import sys
import weakref

import numpy as np
import pytest

import potmesil_mi as pm

torch = pytest.importorskip("torch")

from potmesil_mi.torch import LearnedLens, focus  # noqa: E402

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = 20
VIEW = {"focal_length": 50.0, "frame_width": 2.0, "millimeters_per_unit": 1000.0}
"""A long lens, since a picture of few pixels is of little width."""

DISTANCE, F_NUMBER = 3.0, 2.1


def pictures(batch=1):
    """Random colours of a near square before a slope."""
    generator = torch.Generator().manual_seed(1)
    rgb = torch.rand(batch, 3, SIZE, SIZE, generator=generator)
    depth = 5 + 2 * torch.arange(SIZE) / SIZE * torch.ones(batch, 1, SIZE, 1)
    depth[..., 6:13, 5:12] = 2.0
    return rgb, depth


def attached(*values):
    return [torch.as_tensor(value).clone().requires_grad_() for value in values]


# ---------------------------------------------------------------- pictures


@pytest.mark.parametrize("antialiased", [False, True])
def test_pictures_are_those_of_the_focus_stage(antialiased):
    rgb, depth = pictures()
    lens = pm.ThinLens(
        f_number=F_NUMBER, focus_distance=DISTANCE, aperture="polygon:blades=5", **VIEW
    )
    options = {"antialiased": antialiased, "hidden": "farther"}
    samples = pm.PointSamples.from_image(
        rgb[0].permute(1, 2, 0).numpy(),
        depth[0, 0].numpy(),
        camera=lens.fov,
        lens=lens,
        depth_kind="z",
        **options,
    )
    expected = np.array(pm.focus(samples, lens, lens_points=16, squares=2))
    found = focus(
        *(rgb, depth, DISTANCE, F_NUMBER),
        **VIEW,
        **options,
        aperture="polygon:blades=5",
        lens_points=16,
        squares=2,
    )
    # Sums are scattered in any order.
    np.testing.assert_allclose(found[0].permute(1, 2, 0).numpy(), expected, rtol=0, atol=1e-6)


def test_each_picture_of_a_batch_is_the_one_alone():
    rgb, depth = pictures(2)
    numbers = torch.tensor([4.0, 8.0])
    distances, numbers = attached(torch.tensor([3.0, 4.0]), numbers)
    together = focus(rgb, depth, distances, numbers, **VIEW)
    together.square().sum().backward()
    for i in range(2):
        distance, number = attached(distances[i].detach(), numbers[i].detach())
        alone = focus(rgb[i : i + 1], depth[i : i + 1], distance, number, **VIEW)
        torch.testing.assert_close(alone[0], together[i], rtol=0, atol=1e-6)
        alone.square().sum().backward()
        torch.testing.assert_close(distance.grad, distances.grad[i], rtol=1e-4, atol=0)
        torch.testing.assert_close(number.grad, numbers.grad[i], rtol=1e-4, atol=0)


def test_without_gradients_pictures_are_formed_the_quick_way():
    rgb, depth = pictures()
    (distance,) = attached(DISTANCE)
    with torch.no_grad():
        quick = focus(rgb, depth, distance, F_NUMBER, **VIEW)
    assert not quick.requires_grad
    plain = focus(rgb, depth, DISTANCE, F_NUMBER, **VIEW)
    torch.testing.assert_close(quick, plain, rtol=0, atol=1e-6)
    assert focus(rgb, depth, distance, F_NUMBER, **VIEW).requires_grad


@pytest.mark.parametrize(
    ("dtype", "of_picture"),
    [
        (torch.float16, torch.float32),
        (torch.bfloat16, torch.float32),
        (torch.float32, torch.float32),
        (torch.float64, torch.float64),
    ],
)
def test_other_floats_are_converted_and_get_gradients_of_their_own_type(dtype, of_picture):
    rgb, depth, distance = attached(*(x.to(dtype) for x in (*pictures(), torch.tensor(DISTANCE))))
    picture = focus(rgb, depth, distance, F_NUMBER, **VIEW)
    assert picture.dtype == of_picture
    picture.sum().backward()
    assert [x.grad.dtype for x in (rgb, depth, distance)] == [dtype] * 3


# ---------------------------------------------------------------- gradients


def test_the_gradient_of_colours_is_exact():
    """The picture is linear in them: large steps have little rounding."""
    rgb, depth = pictures()
    rgb = rgb.double().requires_grad_()

    def picture(rgb):
        return focus(rgb, depth, DISTANCE, F_NUMBER, **VIEW)

    assert torch.autograd.gradcheck(picture, rgb, eps=0.5, atol=1e-4, rtol=1e-4, fast_mode=True)


@pytest.mark.parametrize("name", ["focus_distance", "f_number", "focal_length"])
def test_gradients_of_the_lens_are_differences_of_pictures(name):
    """To 1 %, in single precision."""
    rgb, depth = pictures()
    given = {"focus_distance": DISTANCE, "f_number": F_NUMBER, **VIEW}
    value = torch.tensor(given[name], dtype=torch.float64, requires_grad=True)

    def energy(value):
        return focus(rgb, depth, **{**given, name: value}).double().square().sum()

    step = 3e-3 * given[name]
    assert torch.autograd.gradcheck(energy, value, eps=step, atol=0, rtol=1e-2)


@pytest.mark.parametrize(
    ("moved", "step", "tolerance"),
    [("alone", 3e-3, 5e-3), ("near", 1e-2, 0.1), ("far", 1e-2, 0.1), ("all", 1e-2, 0.1)],
)
def test_gradients_of_depth_are_differences_of_pictures(moved, step, tolerance):
    """A slope alone to 0.5 %, in single precision.

    With a near square before it pictures of so few pixels jump a little where a lens point comes
    to see past its edge, which leaves 10 %. Behind it samples copy the pixels beside it.
    """
    rgb, depth = pictures()
    if moved == "alone":
        depth = depth[..., :1, :].expand_as(depth)
    is_near = depth < 3
    which = {"near": is_near, "far": ~is_near}.get(moved, depth > 0)
    scale = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)

    def energy(scale):
        moved_depth = torch.where(which, depth * scale, depth)
        return focus(rgb, moved_depth, DISTANCE, F_NUMBER, **VIEW).double().square().sum()

    assert torch.autograd.gradcheck(energy, scale, eps=step, atol=0, rtol=tolerance)


def test_light_of_hidden_copies_goes_back_to_the_pixels_that_they_copy():
    """A picture of one colour stays so: gradients of all pixels have its sum."""
    _, depth = pictures()
    rgb = torch.ones(1, 3, SIZE, SIZE, requires_grad=True)
    picture = focus(rgb, depth, DISTANCE, F_NUMBER, **VIEW)
    picture.sum().backward()
    torch.testing.assert_close(rgb.grad.sum(), picture.sum().detach(), rtol=1e-4, atol=0)


@pytest.mark.parametrize(
    ("distance", "number"),
    [(DISTANCE, F_NUMBER), (torch.inf, F_NUMBER), (DISTANCE, torch.inf)],
    ids=["open", "focused at infinity", "pinhole"],
)
def test_gradients_are_finite_where_depth_or_lens_are_not(distance, number):
    rgb, depth = pictures()
    depth[..., 14:, :] = torch.inf
    given = attached(rgb, depth, distance, number)
    focus(*given, **VIEW).square().sum().backward()
    assert all(of.grad.isfinite().all() for of in given)
    assert (given[1].grad[..., 14:, :] == 0).all()
    is_open = number < torch.inf
    assert (given[1].grad != 0).any() == is_open
    assert (given[0].grad != 0).all()


def test_the_graph_serves_again_where_it_is_retained_and_is_given_up_where_not():
    rgb, depth = pictures()
    (distance,) = attached(DISTANCE)
    loss = focus(rgb, depth, distance, F_NUMBER, **VIEW).square().sum()
    (first,) = torch.autograd.grad(loss, distance, retain_graph=True)
    (second,) = torch.autograd.grad(loss, distance, retain_graph=True)
    assert first == second != 0
    keeper = loss.grad_fn.next_functions[0][0].next_functions[0][0].saved_tensors[0]
    formed = weakref.ref(keeper.formed[0])
    del keeper
    assert formed() is not None
    loss.backward()
    assert formed() is None
    with pytest.raises(RuntimeError, match="second time"):
        loss.backward()


def test_checkpoints_form_pictures_again():
    from torch.utils.checkpoint import checkpoint

    rgb, depth = pictures()
    one, other = attached(DISTANCE, DISTANCE)
    focus(rgb, depth, one, F_NUMBER, **VIEW).square().sum().backward()

    def picture(distance):
        return focus(rgb, depth, distance, F_NUMBER, **VIEW)

    checkpoint(picture, other, use_reentrant=False).square().sum().backward()
    torch.testing.assert_close(one.grad, other.grad, rtol=1e-4, atol=0)


@pytest.mark.parametrize("name", ["rgb", "depth", "focus_distance"])
def test_second_derivatives_are_refused_by_name(name):
    rgb, depth = pictures()
    given = {"rgb": rgb, "depth": depth, "focus_distance": torch.tensor(DISTANCE)}
    (given[name],) = attached(given[name])
    picture = focus(**given, f_number=F_NUMBER, **VIEW)
    (gradient,) = torch.autograd.grad(picture.sum(), given[name], create_graph=True)
    with pytest.raises(NotImplementedError, match=r"potmesil_mi\.torch\.focus: .*double backward"):
        gradient.square().sum().backward()


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")  # torch itself calls it.
def test_forward_mode_is_no_silent_zero():
    from torch.autograd import forward_ad

    rgb, depth = pictures()
    with forward_ad.dual_level():
        distance = forward_ad.make_dual(torch.tensor(DISTANCE), torch.tensor(1.0))
        with pytest.raises(RuntimeError, match="forward"):
            focus(rgb, depth, distance, F_NUMBER, **VIEW)


@pytest.mark.parametrize(
    ("options", "name", "match"),
    [
        ({"method": "paper"}, "depth", "method=paper"),
        ({"aperture": "lommel"}, "depth", "diffraction"),
        ({"antialiased": True}, "rgb", "antialiased=True"),
    ],
)
def test_what_has_no_derivative_is_refused_by_name(options, name, match):
    given = dict(zip(("rgb", "depth"), pictures(), strict=True))
    given[name].requires_grad_()
    with pytest.raises(NotImplementedError, match=match):
        focus(**given, focus_distance=DISTANCE, f_number=F_NUMBER, **VIEW, **options)


# ---------------------------------------------------------------- what is refused

RGB, DEPTH = pictures(2)


def changed(tensor, value):
    tensor = tensor.clone()
    tensor[1, 0, 2, 3] = value
    return tensor


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"rgb": [RGB[0], RGB[1, :, 2:]]}, TypeError, "rgb=a list of 2: .*several sizes"),
        ({"rgb": RGB.numpy()}, TypeError, r"rgb=.*must be a tensor \(B, 3, H, W\)"),
        ({"rgb": RGB.int()}, TypeError, "rgb: has type torch.int32, must be floats"),
        ({"rgb": RGB[0]}, ValueError, r"rgb: has shape \(3, 20, 20\), must be \(B, 3, H, W\)"),
        ({"rgb": changed(RGB, torch.nan)}, ValueError, "picture 1 of the batch: rgb: 1 of .*nan"),
        ({"depth": RGB}, ValueError, r"depth: has shape \(2, 3, 20, 20\), must be \(B, 1, H, W\)"),
        ({"depth": DEPTH[:1]}, ValueError, r"depth: .*must be \(2, 1, 20, 20\), as rgb"),
        ({"depth": DEPTH[..., 1:]}, ValueError, r"depth: .*must be \(2, 1, 20, 20\), as rgb"),
        ({"depth": changed(DEPTH, torch.nan)}, ValueError, "depth: 1 of .*picture 1 at row 2.*nan"),
        ({"depth": changed(DEPTH, 0.0)}, ValueError, "depth: 1 of .*column 3: 0.0; must be > 0"),
        ({"depth": changed(DEPTH, -1.0)}, ValueError, "depth: .*-1.0; must be > 0"),
        ({"focus_distance": 0.0}, ValueError, "focus_distance=0.0: must be > 0"),
        ({"focus_distance": torch.tensor([3.0, 0.04])}, ValueError, "picture 1.*focus_distance="),
        ({"focus_distance": torch.ones(3)}, ValueError, r"focus_distance: .*\(\) or \(2,\)"),
        ({"f_number": None}, TypeError, "f_number=None: must be a number"),
        ({"f_number": True}, TypeError, "f_number=True: must be a number"),
        ({"f_number": torch.tensor(-1.0)}, ValueError, "f_number=-1.0: must be > 0"),
        ({"focal_length": torch.tensor(True)}, TypeError, "focal_length: has type torch.bool"),
        ({"frame_width": 0}, ValueError, "frame_width=0: must be > 0"),
        ({"method": "papre"}, ValueError, "papre"),
        ({"hidden": "nothing"}, ValueError, "hidden='nothing'"),
    ],
)
def test_errors_name_the_parameter(change, error, match):
    given = {"rgb": RGB, "depth": DEPTH, "focus_distance": DISTANCE, "f_number": F_NUMBER}
    with pytest.raises(error, match=match):
        focus(**{**given, **VIEW, **change})


def test_without_torch_the_import_says_what_to_install():
    code = """
import sys
sys.modules["torch"] = None
import potmesil_mi
try:
    import potmesil_mi.torch
except ImportError as error:
    print(error)"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "pip install 'potmesil_mi[torch]'" in result.stdout


# ---------------------------------------------------------------- the module


def test_a_lens_learns_towards_the_focus_of_a_picture():
    rgb, depth = pictures()
    target = focus(rgb, depth, DISTANCE, F_NUMBER, **VIEW)
    lens = LearnedLens(2.6, 2.6, **VIEW)
    optimizer = torch.optim.Adam(lens.parameters(), lr=0.02)
    losses = []
    for _ in range(4):
        optimizer.zero_grad()
        loss = (lens(rgb, depth) - target).square().mean()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]
    assert 2.6 < lens.focus_distance.item() < DISTANCE


def test_what_a_lens_learns_stays_allowed():
    lens = LearnedLens(0.06, 4.0, **VIEW)
    with torch.no_grad():
        for parameter in lens.parameters():
            parameter -= 5
    assert lens.focus_distance.item() > 0.05
    assert lens.f_number.item() > 0


def test_a_lens_can_be_set_kept_and_learned_in_part():
    lens = LearnedLens(2.0, 4.0, learn=["f_number"], aperture="polygon:blades=5", **VIEW)
    lens.focus_distance = torch.tensor(3.0)
    assert "f_number=4, focal_length=50.0" in repr(lens)
    other = LearnedLens(1.0, 1.0, **VIEW)
    other.load_state_dict(lens.state_dict())
    torch.testing.assert_close(other.focus_distance.item(), 3.0)
    torch.testing.assert_close(other.f_number.item(), 4.0)
    lens(*pictures()).sum().backward()
    grads = {name: of.grad for name, of in lens.named_parameters()}
    assert grads["parametrizations.focus_distance.original"] is None
    assert grads["parametrizations.f_number.original"] != 0


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"focus_distance": float("inf")}, ValueError, "focus_distance=inf: must be finite"),
        ({"focus_distance": 0.04}, ValueError, "focus_distance=0.04"),
        ({"f_number": 0}, ValueError, "f_number=0"),
        ({"learn": "f_number"}, TypeError, "learn='f_number': must be a list"),
        ({"learn": ["focal_length"]}, ValueError, "learn='focal_length': must be one of"),
    ],
)
def test_a_lens_refuses_by_name(change, error, match):
    with pytest.raises(error, match=match):
        LearnedLens(**{"focus_distance": 2.0, "f_number": 4.0, **VIEW, **change})


def test_a_lens_is_not_set_to_what_is_not_allowed():
    lens = LearnedLens(2.0, 4.0, **VIEW)
    with pytest.raises(ValueError, match=r"f_number=-1.0: must be > 0"):
        lens.f_number = torch.tensor(-1.0)
