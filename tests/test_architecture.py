"""The rules of the house, which docs/architecture.md states; nothing of the package is imported."""

import ast
import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = "potmesil_mi"

FLOORS = {
    "ground floor": 0,
    "optics": 1,
    "pictures": 2,
    "samples": 3,
    "filters": 4,
    "motion": 4,
    "tracing": 5,
    "focusing": 5,
    "animation": 6,
    "evaluation": 6,
    "torch": 6,
    "plugins": 7,
    "stacks": 7,
    "living": 8,
    "viewer": 8,
    "cli": 9,
    "front": 10,
}
"""Wings and the floor that each stands on: imports go to the same wing or to a lower floor."""

WITHOUT_MITSUBA = (
    "optics",
    "pictures",
    "samples",
    "filters",
    "focusing",
    "motion",
    "animation",
    "stacks",
    "living",
    "torch",
)

LONGEST_FILE = 450
LONGEST_FUNCTION = 60
REASON = re.compile(r"\blong(,? because|:)", re.IGNORECASE)
"""What a longer function says in its docstring, or in the comment right above it."""

CONVOLUTION = "potmesil_mi.optics.convolution"
TRANSFORMS = {
    CONVOLUTION: "images and their kernels",
    "potmesil_mi.filters.diffraction": "the far field of an aperture",
}
"""Modules that may transform, and what: all convolutions are made by the first."""

TRANSFORM_LIBRARIES = ("scipy.fft", "numpy.fft")
TOO_SLOW_TO_IMPORT = ("scipy.signal", "scipy.stats", "matplotlib")
"""Half a second of every start of the program, for what a few lines do."""

OLD_DIALECT = {
    r"\bper_pixel\b": "squares",
    r"\bPupil\b": "LensPoints",
    r"\bTurns\b": "the jitter of LensPoints",
    r"\bLayers\b": "LensView",
    r"\b_Sheet\b|\b_Band\b": "DepthSlice",
    r"\b_Picture\b": "a compositor",
    r"\bsee_?through\b": "focus_layered",
    r"\bimport spreading\b|\bspreading\.\w": "splat, slices, composite",
    r"\b[Kk]nots?\b": "kernel radii",
    r"\bdescribed\(|\bimport .*\bdescribed\b": "spec",
    r"\bBRIGHT_BESIDE\b|\bHARDLY\b": "a constant that says what it is",
    r"\bdef seen\b|\bimport .*\bseen\b": "trace_visible",
    r"\bclass Image\b|\bpm\.Image\b": "ImageAperture",
    r"\bdef without\b|\bimport .*\bwithout\b": "without_variance",
    r"\bpotmesil_mi\.(checks|files|spreading|elements|layered|paper|tables)\b": "the new layout",
}
"""Private words of before and what stands in their place: see docs/glossary.md."""

OLD_DIALECT_OF_FOCUSING = {
    r"\b[Ee]lements(\s*[=:,)\[]|\.[a-z])|\bElements\b(?! on )": "fragments",
    r"\b[Ss]heets?\b": "slices",
    r"\bthrough_lens\b": "splat, spread, composite",
    r"\.(whole|partial|bright)\b(?<!functools.partial)": "unoccluded, occluded, highlights",
}
"""Words that mean something else, and rightly so, in other wings."""


# ---------------------------------------------------------------- what there is to be seen


def name_of(path):
    """Dotted name of the module in a file; a package has that of its folder."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {name_of(path): path for path in sorted((ROOT / PACKAGE).rglob("*.py"))}


def wing_of(module):
    parts = module.split(".")
    if len(parts) == 1:
        return "front"
    if parts[1] == "__main__":
        return "cli"
    return "ground floor" if parts[1].startswith("_") else parts[1]


@cache
def tree_of(module):
    return ast.parse(FILES[module].read_text(encoding="utf-8"), filename=str(FILES[module]))


def absolute(module, node):
    """The module that ``from ... import`` names, with its dots resolved."""
    if not node.level:
        return node.module
    package = module.split(".") if FILES[module].name == "__init__.py" else module.split(".")[:-1]
    package = package[: len(package) - node.level + 1]
    return ".".join([*package, *([node.module] if node.module else [])])


@cache
def imports_of(module):
    """(line, name) of everything imported anywhere: in functions, for types only, by text."""
    found = []
    for node in ast.walk(tree_of(module)):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            origin = absolute(module, node)
            found += [(node.lineno, f"{origin}.{alias.name}") for alias in node.names]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            found += [
                (node.lineno, argument.value)
                for argument in node.args[:1]
                if isinstance(argument, ast.Constant)
            ]
    return found


def targets(module):
    """(line, module) of the package's own modules that ``module`` imports."""
    for line, name in imports_of(module):
        if name.split(".")[0] == PACKAGE:
            yield line, name if name in FILES else name.rpartition(".")[0]


def functions(module):
    return [
        node
        for node in ast.walk(tree_of(module))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    ]


def docstring_lines(node):
    if ast.get_docstring(node, clean=False) is None:
        return set()
    return set(range(node.body[0].lineno, node.body[0].end_lineno + 1))


@cache
def code_lines(module):
    """Numbers of the lines that have code on them; those of docstrings, too."""
    silent = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    source = FILES[module].read_text(encoding="utf-8")
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in silent:
            lines.update(range(token.start[0], token.end[0] + 1))
    return lines


def code_length(module, function):
    """Lines of code of a function, those within it included."""
    lines = {n for n in code_lines(module) if function.lineno <= n <= function.end_lineno}
    for inner in ast.walk(function):
        if isinstance(inner, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            lines -= docstring_lines(inner)
    return len(lines)


def comment_above(module, function):
    lines = FILES[module].read_text(encoding="utf-8").splitlines()
    first = min([function.lineno, *(d.lineno for d in function.decorator_list)])
    above = []
    for line in reversed(lines[: first - 1]):
        if not line.strip().startswith("#"):
            break
        above.insert(0, line.strip().lstrip("# "))
    return " ".join(above)


def places(found):
    """For the message of a failed test."""
    return "\n" + "\n".join(found)


# ---------------------------------------------------------------- the rules of the rules


def test_every_module_stands_in_a_wing_that_the_order_knows():
    assert [m for m in FILES if wing_of(m) not in FLOORS] == []
    assert len(FILES) > 20


@pytest.mark.parametrize(
    ("module", "line", "expected"),
    [
        ("potmesil_mi.optics.lens", "from .._validation import a", "potmesil_mi._validation"),
        ("potmesil_mi.optics.lens", "from .. import _backend", "potmesil_mi"),
        ("potmesil_mi.optics.lens", "from .psf import b", "potmesil_mi.optics.psf"),
        ("potmesil_mi.optics", "from .psf import b", "potmesil_mi.optics.psf"),
        ("potmesil_mi", "from .optics import psf", "potmesil_mi.optics"),
        ("potmesil_mi.cli", "from scipy import fft", "scipy"),
    ],
)
def test_dots_of_imports_are_resolved(module, line, expected):
    assert absolute(module, ast.parse(line).body[0]) == expected


# ---------------------------------------------------------------- the rules


def test_imports_go_downwards():
    wrong = []
    for module in FILES:
        here = wing_of(module)
        for line, target in targets(module):
            there = wing_of(target)
            if here != there and FLOORS[there] >= FLOORS[here]:
                wrong.append(f"{FILES[module]}:{line}: {here} imports {target} of {there}")
    assert not wrong, places(wrong)


def test_what_is_imported_exists():
    wrong = [
        f"{FILES[module]}:{line}: imports {target}"
        for module in FILES
        for line, target in targets(module)
        if target not in FILES
    ]
    assert not wrong, places(wrong)


def test_no_modules_import_each_other_in_a_circle():
    arrows = {module: {t for _, t in targets(module)} - {module} for module in FILES}
    circles, done = set(), set()

    def follow(module, way):
        if module in way:
            circles.add(" -> ".join([*way[way.index(module) :], module]))
        elif module not in done:
            for target in sorted(arrows[module] & FILES.keys()):
                follow(target, [*way, module])
            done.add(module)

    for module in FILES:
        follow(module, [])
    assert not circles, places(sorted(circles))


def test_the_two_stages_do_not_import_each_other():
    wrong = [
        f"{FILES[module]}:{line}: imports {target}"
        for module in FILES
        for line, target in targets(module)
        if {wing_of(module), wing_of(target)} == {"tracing", "focusing"}
    ]
    assert not wrong, places(wrong)


@pytest.mark.parametrize("wing", WITHOUT_MITSUBA)
def test_the_wing_imports_no_mitsuba(wing):
    wrong = [
        f"{FILES[module]}:{line}: imports {name}"
        for module in FILES
        if wing_of(module) == wing
        for line, name in imports_of(module)
        if name.split(".")[0] == "mitsuba"
    ]
    assert not wrong, places(wrong)


def test_focusing_asks_for_types_and_not_for_attributes():
    wrong = [
        f"{FILES[module]}:{node.lineno}: {ast.unparse(node)}"
        for module in FILES
        if wing_of(module) == "focusing"
        for node in ast.walk(tree_of(module))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "hasattr"
    ]
    assert not wrong, places(wrong)


def test_no_file_is_longer_than_can_be_read_at_once():
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in FILES.values()}
    wrong = [f"{path}: {n} lines" for path, n in lengths.items() if n > LONGEST_FILE]
    assert not wrong, places(wrong)


def test_a_long_function_says_why():
    """Its docstring, or the comment right above it, has ``Long, because`` or ``Long:``."""
    wrong = [
        f"{FILES[module]}:{function.lineno}: {function.name}, {length} lines of code"
        for module in FILES
        for function in functions(module)
        if (length := code_length(module, function)) > LONGEST_FUNCTION
        and not REASON.search(ast.get_docstring(function) or "")
        and not REASON.search(comment_above(module, function))
    ]
    assert not wrong, places(wrong)


def test_only_named_modules_transform():
    wrong = [
        f"{FILES[module]}:{line}: imports {name}"
        for module in FILES
        for line, name in imports_of(module)
        if name.startswith(TRANSFORM_LIBRARIES) and module not in TRANSFORMS
    ]
    wrong += [
        f"{FILES[module]}:{node.lineno}: {ast.unparse(node)}"
        for module in FILES
        for node in ast.walk(tree_of(module))
        if isinstance(node, ast.Attribute)
        and re.fullmatch(r"(np|numpy|scipy)\.fft", ast.unparse(node))
        and module not in TRANSFORMS
    ]
    assert not wrong, places(wrong)


def test_pictures_are_convolved_in_one_place():
    """Only there a product of spectra is transformed back."""
    wrong = lines_with(r"\b(irfft|ifft|irfft2|ifft2|irfftn|ifftn|fftconvolve|oaconvolve)\b", FILES)
    wrong = [line for line in wrong if not line.startswith(str(FILES.get(CONVOLUTION)))]
    assert not wrong, places(wrong)


def test_libraries_that_are_slow_to_import_are_left_out():
    wrong = [
        f"{FILES[module]}:{line}: imports {name}"
        for module in FILES
        for line, name in imports_of(module)
        if name.startswith(TOO_SLOW_TO_IMPORT)
    ]
    assert not wrong, places(wrong)


def test_the_modules_that_may_transform_do():
    idle = [
        module
        for module in TRANSFORMS
        if module not in FILES
        or not any(name.startswith(TRANSFORM_LIBRARIES) for _, name in imports_of(module))
    ]
    assert not idle


def lines_with(word, modules):
    """Lines of the files that have what is searched for, as they are shown."""
    return [
        f"{FILES[module]}:{number}: {line.strip()}"
        for module in modules
        for number, line in enumerate(FILES[module].read_text(encoding="utf-8").splitlines(), 1)
        if re.search(word, line)
    ]


@pytest.mark.parametrize("word", OLD_DIALECT)
def test_no_word_of_the_old_dialect_is_left(word):
    wrong = lines_with(word, FILES)
    assert not wrong, f"the word is now: {OLD_DIALECT[word]}{places(wrong)}"


@pytest.mark.parametrize("word", OLD_DIALECT_OF_FOCUSING)
def test_focusing_speaks_of_what_the_glossary_has(word):
    wrong = lines_with(word, [module for module in FILES if wing_of(module) == "focusing"])
    assert not wrong, f"the word is now: {OLD_DIALECT_OF_FOCUSING[word]}{places(wrong)}"
