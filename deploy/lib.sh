# Read by the scripts beside it: a Python environment in .venv, and nothing anywhere else.
# shellcheck shell=bash

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
venv=$root/.venv

say() { printf '%s\n' "$*" >&2; }
die() { say "${0##*/}: $*"; exit 2; }

# Print the first Python of at least 3.11.
find_python() {
  local name
  for name in "${PYTHON:-}" python3 python3.13 python3.12 python3.11 python; do
    [ -n "$name" ] && command -v "$name" >/dev/null || continue
    # A shim may answer to a name without having the version: so each is asked.
    if "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
      command -v "$name"
      return
    fi
  done
  die "needs Python 3.11 or newer (or PYTHON=/path/to/it)"
}

# Run a command whose output matters only when it fails; on a terminal it may show its progress.
quietly() {
  local log=$venv/install.log
  if [ -t 2 ]; then
    "$@" 1>&2
  elif ! "$@" >"$log" 2>&1; then
    tail -n 30 "$log" >&2
    return 1
  fi
}

# Whether a stamp says: this state, and (at least) these requirements.
installed() {
  [ -f "$1" ] && [ "$(sed -n 1p "$1")" = "$2" ] && { [ -z "$3" ] || [ "$(sed -n 2p "$1")" = "$3" ]; }
}

# Make .venv with the project and the given extra, once for each state of pyproject.toml.
#   set_up EXTRA [REQUIREMENT ...]
set_up() {
  local extra=$1 python stamp wanted
  shift
  if [ ! -x "$venv/bin/python" ]; then
    python=$(find_python) || exit 2
    say "making $venv with $python"
    # A Python without ensurepip can still make the folder; its own pip then fills it.
    "$python" -m venv "$venv" >/dev/null 2>&1 || "$python" -m venv --without-pip --clear "$venv" ||
      die "$python cannot make a virtual environment (package python3-venv?)"
  fi
  pip=("$venv/bin/python" -m pip)
  "${pip[@]}" --version >/dev/null 2>&1 || pip=("$(find_python)" -m pip --python "$venv/bin/python")
  # Two lines: the state of pyproject.toml and Python, and what was asked for beside the project.
  wanted=$("$venv/bin/python" -c '
import hashlib, pathlib, sys
print(hashlib.sha256(pathlib.Path(sys.argv[1]).read_bytes() + sys.version.encode()).hexdigest())' "$root/pyproject.toml")
  if ! installed "$venv/heliograph-$extra.stamp" "$wanted" "$*" && ! installed "$venv/heliograph-dev.stamp" "$wanted" "$*"; then
    say "installing heliograph[$extra] $* into .venv (once; a minute or two)"
    (cd "$root" && quietly "${pip[@]}" install --disable-pip-version-check --no-input --no-cache-dir \
      -e ".[$extra]" "$@") || die "the installation failed; see above"
    printf '%s\n%s\n' "$wanted" "$*" >"$venv/heliograph-$extra.stamp"
  fi
  # Compiled kernels stay inside the environment too.
  export NUMBA_CACHE_DIR=$venv/numba-cache
  export PATH=$venv/bin:$PATH
}

# Compile the kernels once, so that no process spends its first seconds on it.
warm() {
  "$venv/bin/python" -m heliograph_services.cli.warm || die "the kernels do not compile on this machine"
}
