#!/usr/bin/env bash
# Makes .venv and installs quaffure with its development tools into it. `make` calls this when something changed.
set -euo pipefail
cd "$(dirname "$0")/.."
export PIP_DISABLE_PIP_VERSION_CHECK=1
python="${PYTHON:-python3}"

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "set-up: expected Python 3.11 or newer, found $("$python" --version 2>&1). Name one: make PYTHON=python3.12" >&2
    exit 1
}
if [ ! -x .venv/bin/pip ]; then
    echo "set-up: making .venv"
    "$python" -m venv --clear .venv || {
        echo "set-up: $python cannot make environments (Debian: apt install python3-venv)" >&2
        exit 1
    }
fi

install() { .venv/bin/pip install --constraint constraints.txt "$@"; }

# On Linux, PyPI's torch brings gigabytes of CUDA libraries. Without a GPU, the CPU build of the same release is taken:
# from where pip is configured to look, else from PyTorch's own index, else PyPI's build after all.
torch="$(grep '^torch==' constraints.txt)"
if [ "$(uname -s)" = Linux ] && ! command -v nvidia-smi >/dev/null; then
    echo "set-up: installing the CPU build of $torch"
    install "$torch+cpu" 2>.venv/torch.log ||
        install --retries 1 --timeout 30 --extra-index-url https://download.pytorch.org/whl/cpu "$torch+cpu" ||
        {
            echo "set-up: no CPU build of $torch within reach; taking PyPI's, which brings 4 GB of CUDA libraries" >&2
            install "$torch"
        }
else
    install "$torch"
fi
echo "set-up: installing quaffure and its tools: a minute or two"
install --quiet --editable '.[dev]'

# OpenGL comes with the system and not from PyPI. Without a GPU, Mesa draws on the processor.
opens_opengl() {
    .venv/bin/python -c 'from quaffure.apps.render.scene import StrandRenderer; StrandRenderer(8, 8)' 2>.venv/opengl.log
}
packages="libegl1 libgl1 libgl1-mesa-dri"
if ! opens_opengl; then
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        echo "set-up: no OpenGL for pictures and video; as root: apt-get install $packages"
        apt-get -qq update
        # shellcheck disable=SC2086  # a list of words
        DEBIAN_FRONTEND=noninteractive apt-get -qq install --no-install-recommends -y $packages
    fi
    opens_opengl || {
        echo "set-up: no OpenGL for pictures and video. On Debian or Ubuntu: sudo apt install $packages" >&2
        tail -n 1 .venv/opengl.log >&2
        exit 1
    }
fi
echo "set-up: done"
