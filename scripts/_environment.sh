# Sourced by scripts/demo and scripts/test: makes .venv and installs the package when pyproject.toml has changed.
# Usage: environment "[test,dev]"   (or "" for the package alone)

find_python() {
  local name
  for name in python3 python3.13 python3.12 python3.11 python; do
    if command -v "$name" >/dev/null && "$name" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
      echo "$name"
      return
    fi
  done
  echo "Python 3.11 or newer with the venv module was not found (on Debian: apt install python3 python3-venv)" >&2
  return 1
}

environment() {
  local extras=$1 stamp=".venv/installed${1//[^a-z]/-}" hash
  if [ ! -x .venv/bin/python ]; then
    echo "making .venv ..."
    "$(find_python)" -m venv .venv
  fi
  hash=$(.venv/bin/python -c 'import hashlib, sys; print(hashlib.sha256(open("pyproject.toml", "rb").read()).hexdigest(), sys.version_info[:2])')
  if ! grep -qsxF "$hash" "$stamp"; then
    echo "installing the package and what it needs (a minute or two, once) ..."
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -e ".$extras"
    echo "$hash" | tee ".venv/installed" > "$stamp"
  fi
}
