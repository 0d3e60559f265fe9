"""Whatever is in a file: an error that names it, or samples of which a picture can be formed.

``python tests/fuzz/run.py`` tries as many as one likes, in processes of their own.
"""

import numpy as np
import pytest
from fuzz.seeds import broken, is_sound, seeds

CASES = 300
PICTURES = 3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::RuntimeWarning")
@pytest.mark.parametrize("part", range(3))
def test_a_broken_file_is_an_error_that_names_it_or_sound_samples(tmp_path, variant_llvm, part):
    whole, outcomes = seeds(tmp_path), {"error": 0, "samples": 0}
    for number in range(part, CASES, 3):
        rng = np.random.default_rng(number)
        seed = whole[number // 3 % len(whole)]
        path = tmp_path / f"broken{seed.path.suffix}"
        path.write_bytes(broken(seed.path.read_bytes(), rng))
        said = None
        try:
            samples = seed.load(path)
        except (ValueError, OSError) as error:
            said = str(error)
        if said is None:
            # Pictures of a few: each odd size compiles kernels.
            forms = outcomes["samples"] < PICTURES
            assert is_sound(samples, forms), number
            outcomes["samples"] += 1
        else:
            assert path.name in said, (number, said)
            outcomes["error"] += 1
    assert min(outcomes.values()) > 10, outcomes


def test_whole_files_are_sound(tmp_path, variant_llvm):
    for seed in seeds(tmp_path):
        assert is_sound(seed.load(seed.path)), seed.path
