#!/bin/bash
# Trains @COUNT@ runs as a job array. Written by sgs batch --slurm; docs/guide/clusters.md says what the cluster needs.
#SBATCH --job-name=sgs-batch
#SBATCH --array=0-@LAST@
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@120

command=(@COMMAND@)
tasks=@TASKS@
# Largest number of restarts of a task.
restarts=100
# Most expensive first: Slurm starts low indices first.
runs=(
@RUNS@)

names=()
for ((i = SLURM_ARRAY_TASK_ID; i < ${#runs[@]}; i += tasks)); do
    names+=(--only "${runs[i]}")
done

# Passes SIGTERM on: Slurm sends the one before the time limit to this script alone.
child=
signaled=
trap 'signaled=yes; [ -z "$child" ] || kill -TERM "$child" 2>/dev/null' TERM
"${command[@]}" "${names[@]}" </dev/null &
child=$!
[ -z "$signaled" ] || kill -TERM "$child" 2>/dev/null
# A signal ends wait before the program has ended.
while :; do
    signaled=
    wait "$child"
    status=$?
    [ -n "$signaled" ] || break
done

# 75: the run is to go on later. 143: SIGTERM came before the program could handle it.
if [ "$status" = 75 ] || [ "$status" = 143 ]; then
    status=75
    # Slurm itself requeues tasks that are preempted, and never those that are canceled. Only a running task is neither.
    state=$(squeue --noheader --jobs="$SLURM_JOB_ID" --format=%T)
    if [ "$state" = RUNNING ] && [ "${SLURM_RESTART_COUNT:-0}" -lt "$restarts" ]; then
        scontrol requeue "$SLURM_JOB_ID"
    fi
fi
exit "$status"
