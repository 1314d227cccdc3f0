#!/bin/sh
# Says that its set-up is wrong.
echo "vlaps-planner: no such lane" >&2
exit 2
