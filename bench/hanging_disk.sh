#!/usr/bin/env bash
# Records a real set at 1,000 Hz on a disk that hangs for ten seconds, and prints what the set and
# its recorder said. As root, for mount and fsfreeze. From the repository: bench/hanging_disk.sh
set -eu
run=hangs-$$ image=$(mktemp) place=$(mktemp -d) json=$(mktemp)
end() {
    fsfreeze --unfreeze "$place" 2>/dev/null || true
    umount "$place" || true
    rm -rf "$image" "$place" "$json"
}
trap end EXIT
truncate --size 1G "$image"
mkfs.ext4 -q "$image"
mount -o loop "$image" "$place"
./vlaps up --run "$run" --rate 1000 --seed 3 --duration 30 --record "$place/rec" --json "$json" >/dev/null &
set=$!
sleep 8
fsfreeze --freeze "$place"
sleep 10
fsfreeze --unfreeze "$place"
wait "$set"
grep -E "recorder|lost|disk" "runs/$run/logs/recorder.log"
grep -E '"(ended|ticks|skipped|restarts|lost)"' "$json" | sort | uniq -c | sort -rn | head -20
./vlaps replay "$place/rec"
