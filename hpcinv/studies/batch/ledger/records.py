"""Records of a store as one process has read them: which of several counts, and which are damaged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from hpcinv.studies.batch.ledger.case_record import CaseRecord, refusing_other_versions
from hpcinv.studies.batch.ledger.history import Histories, Mark, earlier_histories
from hpcinv.studies.batch.ledger.shards import Line, Place, Shard, Shards
from hpcinv.studies.batch.ledger.store import LEDGER, RECORDS, as_output_error


class Records:
    """Places of the records that count, in the shards and in the files of an earlier ledger.

    Args:
        token: of this process, whose shard it writes.
    """

    def __init__(self, store: Path, token: str, histories: Histories) -> None:
        self._ledger, self._histories = store / LEDGER, histories
        self._shards, self._shard = Shards(store / RECORDS), Shard(store / RECORDS, token)
        self._places: dict[str, Place] = {}
        self._broken: dict[str, int] = {}  # round of a damaged line, by key
        self._unusable: dict[str, tuple[Place, str]] = {}

    def read_all(self) -> None:
        """Read the new lines of all shards."""
        self.read(self._shards.tokens())

    def read(self, tokens: Iterable[str]) -> None:
        """Read the new lines of some shards."""
        for token in tokens:
            with refusing_other_versions(self._shards.path(token)):
                for line in self._shards.new_lines(token):
                    self._note(line)

    def read_earlier(self) -> None:
        """Read which cases are finished in the files of an earlier ledger."""
        for key, history, is_finished in earlier_histories(self._ledger):
            self._histories.begin(key, history)
            if is_finished:
                self._places[key] = Place(history.round, 0, "", 0, 0)

    def add(self, mark: Mark, record: CaseRecord) -> None:
        """Append a record to the shard of this process."""
        key, number, claim = mark
        self._note(Line(self._shard.add(key, number, claim, record), key, is_whole=True))

    def close(self) -> None:
        """Close the shard of this process; another record opens it again."""
        self._shard.close()

    def is_finished(self, key: str) -> bool:
        """Return whether the latest round of a case has a record."""
        place = self._places.get(key)
        return place is not None and place.round == self._histories.of(key).round

    def counted_claim(self, key: str) -> int:
        """Return the claim whose record counts in the latest round of a case; 0 if none does."""
        return self._places[key].claim if self.is_finished(key) else 0

    def is_unfinished_claim(self, mark: Mark) -> bool:
        """Return whether a claim was neither released nor ended with a record of its own."""
        key, number, claim = mark
        history, place = self._histories.of(key), self._places.get(key)
        is_recorded = place is not None and (place.round, place.claim) == (number, claim)
        return history.round == number and claim not in history.released and not is_recorded

    def damage(self, key: str) -> str:
        """Return in what way the record of the latest round of a case is damaged, as far as it was read; else empty."""
        if not self.is_finished(key):
            return _DAMAGED if self._broken.get(key) == self._histories.of(key).round else ""
        place, why = self._unusable.get(key, (None, ""))
        return why if place == self._places[key] else ""

    def note_damage(self, key: str, why: str) -> None:
        """Note that the record of a finished case cannot be used."""
        self._unusable[key] = self._places[key], why

    def briefs(self, keys: Iterable[str]) -> Iterator[tuple[str, CaseRecord]]:
        """Yield key and brief record of each finished case that is not damaged."""
        finished = {key: self._places[key] for key in keys if self.is_finished(key)}
        for key in [key for key, place in finished.items() if not place.token]:
            del finished[key]
            if (record := self.whole(key)) is not None:
                yield key, record.brief()
        yield from self._shards.briefs(finished)

    def whole(self, key: str) -> CaseRecord | None:
        """Return the record of a case; ``None`` if it is not finished, or if it is damaged, which is noted."""
        if not self.is_finished(key):
            return None
        place = self._places[key]
        file = self._shards.path(place.token) if place.token else self._earlier_file(key, place.round)
        try:
            with refusing_other_versions(file):
                if place.token:
                    return self._shards.whole(place)
                with as_output_error(file):
                    return CaseRecord.decoded(file.read_bytes())
        except ValueError as error:
            self.note_damage(key, str(error))
            return None

    def _earlier_file(self, key: str, number: int) -> Path:
        return self._ledger / key[:2] / f"{key}.record-{number}.json"

    def _note(self, line: Line) -> None:
        """Note the place of a record; the one of the latest round with the highest claim counts."""
        if not line.is_whole:
            self._broken[line.key] = line.place.round
        elif (known := self._places.get(line.key)) is None or known < line.place:
            self._places[line.key] = line.place


_DAMAGED = "the digest does not match"
