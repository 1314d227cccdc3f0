#!/usr/bin/env bash
# Records a real set at 1,000 Hz while it is swapped and killed: every ten seconds new weights,
# and in turn the planner, gate, controller or world dies by SIGKILL (each fifth time none).
# Then replays the recording. From the repository: bench/troubled_run.sh SECONDS FOLDER
set -u
seconds=${1:?seconds} folder=${2:?folder of the recording}
run=troubled-$$
weights=(results/learning/ppl-50000.onnx results/learning/ppl-10000.onnx)
turns=(planner gate controller world none)

./vlaps up --run "$run" --rate 1000 --gate rules --policy "${weights[0]}" --record "$folder" \
    --duration "$seconds" --set record.max_mb=12000 --set supervisor.restarts_max=1000 &
set=$!
sleep 10
turn=0
while kill -0 "$set" 2>/dev/null; do
    ./vlaps swap "${weights[$((++turn % 2))]}" --run "$run"
    sleep 6
    victim=vlaps-${turns[$((turn % 5))]}
    for pid in $(pgrep -P "$set"); do
        [ "$(basename "$(readlink "/proc/$pid/exe")")" = "$victim" ] && kill -KILL "$pid"
    done
    sleep 4
done
wait "$set"
./vlaps replay "$folder"
