#!/bin/sh
# Gives the processes that tick the right to real-time scheduling
# and to locked memory. To be run again after each build: a new file has none.
#   supervisor/grants/capabilities.sh [FOLDER OF THE PROGRAMS]
set -eu
folder=${1:-target/release}
for program in world planner controller; do
    sudo setcap cap_sys_nice,cap_ipc_lock+ep "$folder/vlaps-$program"
done
