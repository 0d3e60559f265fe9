import importlib
import importlib.util
import pkgutil
import subprocess
import sys
import threading

import pytest

from potmesil_mi._hook import watch_import


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Name of a module that can be imported and says so in `sys.told`."""
    name = "module_that_is_watched"
    (tmp_path / f"{name}.py").write_text("import sys\nsys.told.append('executed')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    monkeypatch.setattr(sys, "told", [], raising=False)
    yield name
    sys.modules.pop(name, None)


def tell(text):
    return lambda: sys.told.append(text)


def test_both_functions_are_called_around_the_first_import(module):
    finders = list(sys.meta_path)
    watch_import(module, before=tell("before"), after=tell("after"))
    assert sys.told == []
    importlib.import_module(module)
    importlib.import_module(module)
    assert sys.told == ["before", "executed", "after"]
    assert sys.meta_path == finders


def test_both_are_called_at_once_where_the_module_is_there(module):
    importlib.import_module(module)
    watch_import(module, before=tell("before"), after=tell("after"))
    assert sys.told == ["executed", "before", "after"]


def test_looking_for_the_module_calls_nothing(module):
    watch_import(module, before=tell("before"))
    assert importlib.util.find_spec(module).origin.endswith(f"{module}.py")
    assert sys.told == []


def test_the_module_keeps_its_own_loader(module):
    plain = type(importlib.util.find_spec(module).loader)
    watch_import(module)
    imported = importlib.import_module(module)
    assert type(imported.__loader__) is plain
    assert type(imported.__spec__.loader) is plain
    assert importlib.reload(imported) is imported


@pytest.mark.parametrize("when", ["before", "after"])
def test_an_error_comes_out_of_the_import_and_again_out_of_the_next(module, when):
    def fail():
        raise ImportError("no LLVM")

    watch_import(module, **{when: fail})
    for _ in range(2):
        with pytest.raises(ImportError, match="no LLVM"):
            importlib.import_module(module)
        assert module not in sys.modules


def test_two_modules_may_be_watched(module):
    watch_import("never_imported", before=tell("never"))
    watch_import(module, after=tell("after"))
    importlib.import_module(module)
    assert sys.told == ["executed", "after"]


def test_a_module_that_does_not_exist_is_still_not_found():
    watch_import("no_such_module", before=tell("before"))
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        importlib.import_module("no_such_module")
    sys.meta_path.pop(0)


class Asking:
    """A finder that asks all finders, as that of this package does."""

    def __init__(self):
        self.calls = 0

    def find_spec(self, name, path=None, target=None):
        self.calls += 1
        finders = [finder for finder in sys.meta_path if finder is not self]
        found = (finder.find_spec(name, path, target) for finder in finders)
        return next((spec for spec in found if spec is not None), None)


def test_another_finder_that_asks_all_does_not_ask_for_ever(module):
    watch_import(module, before=tell("before"), after=tell("after"))
    asking = Asking()
    sys.meta_path.insert(1, asking)
    importlib.import_module(module)
    assert sys.told == ["before", "executed", "after"]
    assert asking.calls == 1


def test_threads_that_look_at_once_do_not_disturb_each_other(module):
    watch_import(module)
    ours, inside, go = sys.meta_path[0], threading.Event(), threading.Event()

    class Waiting:
        def find_spec(self, name, path=None, target=None):
            if threading.current_thread() is other:
                inside.set()
                go.wait(10)

    other = threading.Thread(target=importlib.util.find_spec, args=[module])
    sys.meta_path.insert(1, Waiting())
    other.start()
    assert inside.wait(10)
    try:
        assert ours.find_spec(module) is not None
    finally:
        go.set()
        other.join()


def test_a_second_watch_of_a_module_takes_the_place_of_the_first(module):
    finders = list(sys.meta_path)
    watch_import(module, before=tell("first"))
    watch_import(module, before=tell("second"))
    importlib.import_module(module)
    assert sys.told == ["second", "executed"]
    assert sys.meta_path == finders


def test_a_finder_of_an_old_kind_is_passed_over(module):
    watch_import(module, after=tell("after"))
    sys.meta_path.insert(1, object())
    assert sys.meta_path[0].find_spec(module).origin.endswith(f"{module}.py")


def test_somebody_may_remove_the_finder_meanwhile(module):
    finders = list(sys.meta_path)

    def remove():
        sys.meta_path[:] = finders

    watch_import(module, before=remove, after=tell("after"))
    importlib.import_module(module)
    assert sys.told == ["executed", "after"]


def test_the_loader_that_is_found_has_all_that_the_module_s_own_has(module):
    own = importlib.util.find_spec(module).loader
    watch_import(module)
    loader = importlib.util.find_spec(module).loader
    assert loader.get_filename(module) == own.get_filename(module)
    assert not hasattr(loader, "no_such_attribute")
    assert not hasattr(object.__new__(type(loader)), "loader")
    assert pkgutil.get_data(module, f"{module}.py").startswith(b"import sys")


RELOADED = {
    "reload": "importlib.reload(potmesil_mi)",
    "reload of the hook": "importlib.reload(potmesil_mi._hook); importlib.reload(potmesil_mi)",
    "import again": """
for name in [name for name in sys.modules if name.partition(".")[0] == "potmesil_mi"]:
    del sys.modules[name]
import potmesil_mi""",
}
BEFORE_MITSUBA = """
import importlib, sys
import potmesil_mi
{}
import mitsuba as mi
mi.set_variant("scalar_rgb")
print(mi.load_dict({{"type": "potmesil", "f_number": 5.6}}).lens().f_number)
print(sum("_hook" in type(finder).__module__ for finder in sys.meta_path))
"""
AFTER_MITSUBA = """
import importlib, sys
import potmesil_mi, mitsuba as mi
{}
from potmesil_mi import plugins
{}
calls = []
sys.setprofile(lambda frame, event, _: event == "call" and calls.append(frame.f_code.co_name))
mi.set_variant("scalar_rgb")
sys.setprofile(None)
print(mi.load_dict({{"type": "potmesil", "f_number": 5.6}}).lens().f_number)
print(calls.count("_follow_variant"))
"""


def run(code):
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.parametrize("reloading", RELOADED.values(), ids=RELOADED)
def test_the_package_can_be_loaded_anew_before_mitsuba(reloading):
    assert run(BEFORE_MITSUBA.format(reloading)) == "5.6\n0\n"


@pytest.mark.parametrize("reloading", RELOADED.values(), ids=RELOADED)
@pytest.mark.parametrize("more", ["", "importlib.reload(plugins).follow_variants()"])
def test_the_package_loaded_anew_after_mitsuba_registers_its_plugins_once(reloading, more):
    assert run(AFTER_MITSUBA.format(reloading, more)) == "5.6\n1\n"
