#!/usr/bin/env bash
# A SLURM array job: each element does one part of the work, and keeps it in --out, a folder
# that all nodes see. Build once before (./vlaps doctor does), then:
#
#   sbatch examples/cluster/slurm.sh
#   ./vlaps eval --out runs/mpc --report --json mpc.json     when all have ended
#
# Elements that failed are named by --report; `sbatch --array=3,5 examples/cluster/slurm.sh`
# runs these alone. A part that was stopped or killed continues.
#SBATCH --job-name=vlaps-eval
#SBATCH --array=1-8
#SBATCH --cpus-per-task=2
#SBATCH --time=04:00:00
#SBATCH --output=vlaps-eval-%A-%a.log
#SBATCH --requeue
#SBATCH --signal=B:TERM@60
set -euo pipefail

# sbatch copies this file elsewhere; the folder in which it was called is the repository.
cd "${SLURM_SUBMIT_DIR:?sbatch sets it}"
# What is built is used, on every node the same.
export VLAPS_NO_BUILD=1

# exec: the signal at the end of the time reaches the program, which keeps what is finished.
exec ./vlaps eval --driver mpc --episodes 8000 --out runs/mpc --shard "${SLURM_ARRAY_TASK_ID:?sbatch sets it}/8"
