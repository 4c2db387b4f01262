#!/usr/bin/env bash
# Makes the environment of a peer in benchmarks/peers/env/PEER: bash benchmarks/peers/set_up.sh dismech|mujoco
# Nothing of it is a dependency of quaffure. dismech takes 690 MB, mujoco 210 MB.
# Versions are those that docs/peers.md was measured with.
set -euo pipefail

peer=${1:?"which peer: dismech or mujoco"}
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
case $peer in
    dismech) packages=(dismech-newton==0.1.0.post4 newton==1.6.1 warp-lang==1.19.0 scipy==1.17.1 numpy==2.4.6) ;;
    mujoco) packages=(mujoco==3.17.0 numpy==2.4.6) ;;
    *) echo "no peer '$peer': dismech or mujoco" >&2; exit 2 ;;
esac

env=$here/env/$peer
"${PYTHON:-python3}" -m venv "$env"
"$env/bin/pip" install --quiet "${packages[@]}"

if [[ $peer == dismech ]]; then
    # Its annotation `Slots | None` of a warp struct is no valid expression below Python 3.14, and importing it fails.
    contact=$("$env/bin/python" -c 'import importlib.util as u; print(u.find_spec("dismech_newton").submodule_search_locations[0])')/contact.py
    sed -i 's/def snapshot(self) -> Slots | None:/def snapshot(self) -> "Slots | None":/' "$contact"
fi
"$env/bin/python" -c "import ${peer/#dismech/dismech_newton}"
echo "$env is ready"
