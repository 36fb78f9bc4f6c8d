#!/bin/bash
#SBATCH --job-name=turntable
#SBATCH --ntasks=16                # workers, one OpenCL device each
#SBATCH --cpus-per-task=8
#SBATCH --time=01:00:00
#
# An animation on the workers of one SLURM job: sbatch slurm.sh SCENE 'frames/%04d.png'
# After a failure, or for more frames, the same command goes on: what is there is kept.
set -euo pipefail
scene=$1 output=$2
folder=$(mktemp -d "$PWD/.dask-XXXXXX")            # on a disk that all nodes see
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$folder"' EXIT

dask scheduler --scheduler-file "$folder/scheduler.json" --no-dashboard --port 0 &>"$folder/scheduler.log" &
srun dask worker --scheduler-file "$folder/scheduler.json" --nthreads 1 --resources opencl=1 --memory-limit 0 \
    --no-dashboard --local-directory "${TMPDIR:-/tmp}" &>"$folder/workers.log" &

until [ -s "$folder/scheduler.json" ]; do sleep 0.2; done
clvol render "$scene" -o "$output" --scheduler "$folder/scheduler.json" --resume
