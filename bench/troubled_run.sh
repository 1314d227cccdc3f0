#!/usr/bin/env bash
# Records two real sets at 1,000 Hz, one after the other, while they are swapped and killed:
# FOLDER/judge with the built-in judge, FOLDER/person with a person at the keys, who takes over
# for 8 of every 20 seconds. Every ten seconds new weights come, and in turn the planner, gate,
# controller or world dies by SIGKILL (each fifth time none; the person's set has no gate).
# Then replays both recordings; exit code 1 when a byte differs. From the repository:
# bench/troubled_run.sh SECONDS FOLDER, half of the seconds for each set.
set -u
seconds=$((${1:?seconds} / 2)) folder=${2:?folder of the recordings}
weights=(results/learning/ppl-50000.onnx results/learning/ppl-10000.onnx)
turns=(planner gate controller world none)
mkdir -p "$folder"

# The keys of a person: takes over, accelerates and steers to both sides, brakes, gives back.
keys() {
    for ((at = 5; at < seconds; at += 20)); do
        printf '%s\n' "$at.0 space"
        for k in 0 1 2 3 4 5; do
            printf '%s\n' "$((at + k)).2 w" "$((at + k)).3 $([ $((k % 2)) = 0 ] && echo a || echo d)" \
                "$((at + k)).7 w"
        done
        printf '%s\n' "$((at + 6)).5 s" "$((at + 8)).0 space"
    done
}

# Drives a set with these options of `up`, and troubles it until it ends.
troubled() {
    local name=$1 run=troubled-$1-$$ turn=0 set victim pid
    shift
    ./vlaps up --run "$run" --rate 1000 --policy "${weights[0]}" --record "$folder/$name" \
        --duration "$seconds" --set record.max_mb=12000 --set supervisor.restarts_max=1000 "$@" &
    set=$!
    sleep 10
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
}

keys >"$folder/keys.txt"
troubled judge --gate rules
troubled person --gate human --keys "$folder/keys.txt"
failed=0
for name in judge person; do
    ./vlaps replay "$folder/$name" --json "$folder/$name.json" || failed=1
done
exit "$failed"
