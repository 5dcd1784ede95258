# Sourced by the other scripts, from the top of the repository: makes .venv with this checkout
# installed in it, and puts it first on the PATH. Installs again only when what is to be
# installed has changed. PYTHON chooses the interpreter that .venv is made with.
PYTHON=${PYTHON:-python3}
if ! "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 10))'; then
    echo "$PYTHON is not Python 3.10 or later: set PYTHON to one that is" >&2
    exit 1
fi
# A .venv whose making was interrupted has no pip.
.venv/bin/python -m pip --version >/dev/null 2>&1 || "$PYTHON" -m venv .venv
installed=.venv/installed
wanted="$PWD $(cat setup.cfg pyproject.toml | cksum)"
if [ "$(cat "$installed" 2>/dev/null)" != "$wanted" ]; then
    echo "installing into .venv (some 500 MB, once) ..."
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -e '.[test,mie]'
    echo "$wanted" >"$installed"
fi
export PATH="$PWD/.venv/bin:$PATH"
