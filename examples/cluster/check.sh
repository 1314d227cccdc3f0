#!/usr/bin/env bash
# Checks what ./vlaps cluster prints with the programs that will read it, on this machine alone:
# a slurmctld and a slurmd of its own, and the schema of Kubernetes. Needs root for slurmd, and
#
#   apt-get install --no-install-recommends slurmctld slurmd slurm-client munge
#   pip install kubernetes-validate
#
# Build before (./vlaps doctor does). An array of eight parts of which three are killed and
# submitted again is compared with one process: all figures but that of the wall clock are equal.
set -euo pipefail
cd "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")/../.."
export VLAPS_NO_BUILD=1

command -v kubernetes-validate >/dev/null || { echo "kubernetes-validate is missing: see the head of $0" >&2; exit 2; }
for program in munged slurmctld slurmd sbatch; do
    command -v $program >/dev/null || { echo "$program is missing: see the head of $0" >&2; exit 2; }
done

place=$(mktemp -d)
end() {
    for daemon in slurmd ctld munge; do
        [[ ! -e $place/$daemon.pid ]] || kill "$(<"$place/$daemon.pid")" || true
    done
    rm -rf -- "$place"
}
trap end EXIT

mkdir -m 700 "$place/munge" "$place/state" "$place/spool"
head -c 1024 /dev/urandom >"$place/munge/key"
chmod 400 "$place/munge/key"
munged --force --key-file="$place/munge/key" --socket="$place/munge/socket" --pid-file="$place/munge.pid" \
    --seed-file="$place/munge/seed" --log-file="$place/munge/log"
cat >"$place/slurm.conf" <<CONF
ClusterName=one
SlurmctldHost=$(hostname)(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$place/munge/socket
CredType=cred/munge
StateSaveLocation=$place/state
SlurmdSpoolDir=$place/spool
SlurmctldPidFile=$place/ctld.pid
SlurmdPidFile=$place/slurmd.pid
SlurmctldLogFile=$place/ctld.log
SlurmdLogFile=$place/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
ReturnToService=2
NodeName=$(hostname) NodeAddr=127.0.0.1 CPUs=$(nproc) State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF=$place/slurm.conf
slurmctld
slurmd
until [[ $(sinfo --noheader --format=%T) == idle ]]; do sleep 0.2; done
slurmctld -V

commands=("eval --driver mpc --out /results/eval" "train --algorithm ppl --seeds 8 --out /results/train"
    "sweep --seeds 8 --out /results/sweep" "regress recordings --policy policy.onnx --out /results/regress")
for command in "${commands[@]}"; do
    # Words of a command, without quotes in them.
    read -ra words <<<"$command"
    ./vlaps cluster slurm -- "${words[@]}" | sbatch --test-only
    ./vlaps cluster kubernetes -- "${words[@]}" >"$place/${words[0]}.yaml"
done
sbatch --test-only examples/cluster/slurm.sh
kubernetes-validate --strict "$place"/*.yaml examples/cluster/kubernetes.yaml
sed 's/completions:/completion:/' examples/cluster/kubernetes.yaml >"$place/wrong.yaml"
if kubernetes-validate --strict "$place/wrong.yaml" 2>/dev/null; then
    echo "a wrong manifest passes" >&2
    exit 1
fi

# An array in which three parts are killed while they drive.
work=(eval --driver rrt-star --episodes 160 --out "$place/parts")
./vlaps cluster slurm --shards 8 --cores 1 -- "${work[@]}" | sed "s|^#SBATCH --output=.*|#SBATCH --output=$place/%a.log|" >"$place/job.sh"
job=$(sbatch --parsable "$place/job.sh")
for part in 1 4 8; do
    # Some of its episodes are kept, and not all.
    until [[ $(cat "$place/parts/shard-$part-of-8."* 2>/dev/null | wc -l) -gt 3 ]]; do sleep 0.05; done
    scancel --full --signal=KILL "${job}_$part"
done
until [[ -z $(squeue --noheader) ]]; do sleep 0.2; done
if ./vlaps eval --out "$place/parts" --report; then
    echo "a report without three parts is complete" >&2
    exit 1
fi
sbatch --wait --array=1,4,8 "$place/job.sh"
./vlaps eval --out "$place/parts" --report --json "$place/parts.json"
./vlaps eval --driver rrt-star --episodes 160 --json "$place/one.json" >/dev/null
# The one figure of the wall clock differs.
diff <(grep -v planning_p99_us "$place/parts.json") <(grep -v planning_p99_us "$place/one.json")
echo "eight parts, three of them killed: the figures of one process"
