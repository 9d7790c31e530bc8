# shellcheck shell=bash
# What the batch scripts share. They source it, and call `launch COMMAND...`, which runs a parallel command and passes
# Slurm's signals on to it. If it has saved its state and stopped (exit code 75) since the time limit came near or the
# job is preempted, then the job goes back into the queue; after TERM, which scancel sends, it does not.
#
# HPCINV_LAUNCHER  what starts the ranks, such as "srun --mpi=pmi2 --kill-on-bad-exit" (left out: mpirun)
# HPCINV_REQUEUES  how often a job is requeued at most (left out: 50)

usr1='' term='' signalled='' launched='' early=()

pass_on() { # SIGNAL
    signalled=yes
    if [ -n "$launched" ]; then kill -s "$1" "$launched" 2>/dev/null; else early+=("$1"); fi
}
# From the start: a signal without a trap would end the script.
trap 'usr1=yes; pass_on USR1' USR1
trap 'term=yes; pass_on TERM' TERM

launch() {
    local launcher signal code=75
    read -ra launcher <<<"${HPCINV_LAUNCHER:-mpirun}"
    if [ -z "$signalled" ]; then
        "${launcher[@]}" "$@" &
        launched=$!
        for signal in "${early[@]}"; do pass_on "$signal"; done # it runs before it has a name here
        await_launched
        code=$?
    fi
    [ "$code" != 75 ] || [ -n "$term" ] || requeue
    return "$code"
}

await_launched() {
    local code=127 now
    # A signal interrupts `wait`, and its exit code then looks like that of a command which a signal has ended. So wait
    # until no signal came meanwhile; 127 says that there is nothing left to wait for.
    while :; do
        signalled=''
        wait "$launched"
        now=$?
        [ "$now" = 127 ] || code=$now
        [ -n "$signalled" ] || return "$code"
    done
}

requeue() {
    # One task of an array has the id of the whole array, by which all of its tasks would be requeued.
    local job=$SLURM_JOB_ID most=${HPCINV_REQUEUES:-50}
    [ -z "${SLURM_ARRAY_TASK_ID:-}" ] || job=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
    # A site may preempt by USR1, too (preempt_send_user_signal). Else the ranks get TERM, and this script gets nothing.
    [ -n "$usr1" ] || scontrol show job "$job" | grep -q 'PreemptTime=[0-9]' || return
    if [ "${SLURM_RESTART_COUNT:-0}" -ge "$most" ]; then
        echo "job $job: not requeued any more, since it was $most times: is its time limit too short to get anywhere?" >&2
        return
    fi
    echo "job $job: has saved its state, and is requeued to go on"
    trap '' TERM # which Slurm sends as it takes the job back
    scontrol requeue "$job"
}
