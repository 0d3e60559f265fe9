import importlib
import importlib.util
import sys

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
