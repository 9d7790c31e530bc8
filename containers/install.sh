#!/bin/sh
# Installs hpcinv from the directory of this repository, as root on Debian 13: the steps of Dockerfile and hpcinv.def.
set -eu
cd "$(dirname "$0")/.."
apt-get update -qq
apt-get install -y -qq --no-install-recommends ca-certificates python3 python3-venv \
  gcc libc6-dev libgl1 libglu1-mesa libgomp1 libxcursor1 libxft2 libxinerama1
python3 -m venv /opt/uv
/opt/uv/bin/pip install --quiet uv
# The environment is made with Debian's Python, whichever version developers use.
UV_PYTHON=/usr/bin/python3 UV_PROJECT_ENVIRONMENT=/opt/venv /opt/uv/bin/uv sync --no-dev --no-editable --compile-bytecode --extra checkpoints --extra all
# mpirun looks for its proxy next to the name by which it was called.
ln -sf /opt/venv/bin/hpcinv /opt/venv/bin/mpirun /opt/venv/bin/hydra_* /usr/local/bin/
