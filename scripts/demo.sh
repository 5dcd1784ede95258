#!/usr/bin/env bash
# Simulates nine views of a generated cloud, recovers the cloud from them, and leaves
# everything in a folder of its own: runs/demo, or runs/demo-2, runs/demo-3 ...
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/setup.sh

run=runs/demo
number=1
while [ -e "$run" ]; do
    number=$((number + 1))
    run=runs/demo-$number
done
mkdir -p "$run"
cp scripts/demo/*.toml "$run"

echo "1. a cumulus of 32 x 32 x 32 voxels"
cloudtomo cloud --generate cumulus --shape 32 32 32 --spacing 0.025 0.025 0.025 --seed 1 --output "$run/cloud.nc"
echo "2. nine views of it"
cloudtomo render "$run/scene.toml" --samples 1024 --seed 1 --output "$run/images.nc" --png "$run/images"
# Other random numbers than those of the images: nothing is recovered by their coincidence.
echo "3. the cloud from the nine views, coarse to fine"
cloudtomo reconstruct "$run/run.toml" --seed 2 --output "$run"
