"""Ledger of a store: finished cases, and the processes that work on others, in any number of allocations at once.

It has two parts, which are only ever added to:

- the *log* (`log`): claims of blocks of cases, releases, notes of crashes, and the begin of further rounds of cases.
  All processes agree on its order.
- the *shards* (`shards`): the records of finished cases, appended by each process to files of its own.

A case has rounds: the first one, and another one each time that it is opened again, since it failed or its record is
damaged. The claims of a round have the numbers 1, 2, …, in the order of the log. A case is finished if its round has a
record; of several, the one with the highest claim counts. Else it is open; it is held if its last claim was not
released and the holder of that is not dead (`liveness`). A holder works on the cases of a block in their order, so that
the first one without a record of its own is the one at hand. If it dies, only this one counts as an attempt; the claims
of the others are released by the next holder.

**Nothing is done twice.** A process that adds a claim to the log has read all earlier ones. If there were claims before
in this round, their holders have released them or are dead, and it has read their shards. So two processes can hold a
case at a time only if one was taken for dead and continues. Then *the one appends its record, and reads the log after
that; the other one adds its claim, and reads the shard after that*. At least one of them finds what the other one has
written: the first one `commit` returns ``False`` to, or the second one gives its claim up. So `commit` returns ``True``
once for a round at most, and the record that it wrote stays the one that counts. A record of a process that was taken
for dead counts until its successor has one. When such a process saves, it finds that its run directory was renamed.

**Nothing is lost.** Whenever a process is killed, it leaves nothing, a partial file with a unique name, an entry with
claims that lack a living holder, an incomplete last line in its shard, or a whole record. None of these has to be
repaired. The checkpoints of its run are in the run directory, which the next claim renames.

Not covered: an entry of the log that a disk has damaged after it was written. Its cases may be solved a second time.

Stores of format 1 have one file for each record and each claim (`earlier_histories`). They are read; what is new goes
to the log and the shards.
"""
