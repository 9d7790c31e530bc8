# shellcheck shell=bash
# What the batch scripts share. They source it, and call `launch COMMAND...`, which runs a parallel command and passes
# Slurm's signals on to it. If it has saved its state and stopped (exit code 75) since the time limit came near or the
# job is preempted, then the job goes back into the queue; after TERM, which scancel sends, it does not. A job that has
# saved nothing since it began is requeued twice in a row at most.
#
# HPCINV_LAUNCHER  what starts the ranks, such as "srun --mpi=pmi2 --kill-on-bad-exit" (left out: mpirun)
# HPCINV_REQUEUES  how often a job is requeued at most (left out: 50)

usr1='' term='' signalled='' launched='' early=() job='' saved='' idle=''

pass_on() { # SIGNAL
    signalled=yes
    if [ -n "$launched" ]; then kill -s "$1" "$launched" 2>/dev/null; else early+=("$1"); fi
}
# From the start: a signal without a trap would end the script.
trap 'usr1=yes; pass_on USR1' USR1
trap 'term=yes; pass_on TERM' TERM

launch() {
    local launcher signal code=75
    # One task of an array has the id of the whole array, which would requeue all of its tasks.
    job=$SLURM_JOB_ID
    [ -z "${SLURM_ARRAY_TASK_ID:-}" ] || job=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
    saved=$PWD/.hpcinv-$job.saved idle=$PWD/.hpcinv-$job.idle
    export HPCINV_SAVED=$saved # hpcinv makes this file when it has saved something
    rm -f "$saved"
    warn_of_lead
    read -ra launcher <<<"${HPCINV_LAUNCHER:-mpirun}"
    if [ -z "$signalled" ]; then
        "${launcher[@]}" "$@" &
        launched=$!
        for signal in "${early[@]}"; do pass_on "$signal"; done # it runs before it has a name here
        await_launched
        code=$?
    fi
    if [ "$code" = 75 ] && [ -z "$term" ]; then requeue; else rm -f "$idle"; fi
    rm -f "$saved"
    return "$code"
}

warn_of_lead() {
    # The last option of this script, unless sbatch was given another one, which nothing here can see.
    local lead limit days=0 hours minutes seconds
    lead=$(sed -n 's/^#SBATCH .*--signal=[^@]*@\([0-9]*\).*/\1/p' "$0" 2>/dev/null | tail -1)
    limit=$(scontrol show job "$job" 2>/dev/null | sed -n 's/.*TimeLimit=\([-0-9:]*\).*/\1/p' | head -1)
    case $limit in *-*) days=${limit%%-*} limit=${limit#*-} ;; esac
    IFS=: read -r hours minutes seconds <<<"$limit"
    [ -n "$lead" ] && [ -n "$seconds" ] || return 0
    limit=$((86400 * days + 3600 * 10#$hours + 60 * 10#$minutes + 10#$seconds))
    [ "$limit" -gt "$lead" ] || echo "job $job: warning: its time limit of $limit s is not above the $lead s that are" \
        "kept for saving (--signal=B:USR1@$lead): give it more time, or a smaller lead" >&2
}

await_launched() {
    local code=127 now
    # A signal interrupts `wait`, and its exit code then looks as if a signal had ended the command. So wait
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
    local most=${HPCINV_REQUEUES:-50} without=0
    # A site may preempt by USR1, too (preempt_send_user_signal). Else the ranks get TERM, and this script gets nothing.
    [ -n "$usr1" ] || scontrol show job "$job" | grep -q 'PreemptTime=[0-9]' || return
    if [ "${SLURM_RESTART_COUNT:-0}" -ge "$most" ]; then
        echo "job $job: not requeued any more, since it was $most times: is its time limit too short to get anywhere?" >&2
        return
    fi
    if [ -e "$saved" ] || [ ! -w "$PWD" ]; then # where nothing can be written, nothing is known
        rm -f "$idle"
        echo "job $job: has saved its state, and is requeued to go on"
    else
        [ ! -e "$idle" ] || read -r without <"$idle"
        if [ "$without" -ge 2 ]; then
            rm -f "$idle"
            echo "job $job: not requeued any more: three times in a row it was stopped before it could save anything." \
                "Give it more time, or a smaller lead (--signal=B:USR1@SECONDS)" >&2
            return
        fi
        # Without a file for the count, SLURM_RESTART_COUNT and HPCINV_REQUEUES end it.
        echo $((without + 1)) >"$idle" 2>/dev/null
        echo "job $job: was stopped before it could save anything, and is requeued to try again"
    fi
    trap '' TERM # which Slurm sends as it takes the job back
    scontrol requeue "$job"
}
