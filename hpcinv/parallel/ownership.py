"""Whether somebody other than root and this user could have written a file or directory."""

from __future__ import annotations

import grp
import os
import pwd
import stat
from pathlib import Path


def foreign_hand(status: os.stat_result) -> str:
    """Why another user could have written what has this ``status``; empty if none could.

    Access control lists count as far as they show in the mode, whose group bits are then the most that they allow.
    """
    if status.st_uid not in (0, os.geteuid()):
        return f"belongs to {_user(status.st_uid)}"
    if status.st_mode & stat.S_IWOTH:
        return "can be written by everybody"
    if status.st_mode & stat.S_IWGRP and not _is_private(status.st_gid):
        return f"can be written by the group {_group(status.st_gid)}"
    return ""


def foreign_hand_above(path: Path) -> tuple[Path, str] | None:
    """The directory above ``path`` in which another user could exchange it, and why; ``None`` if there is none.

    The owners of directories above are not asked: who owns the place of a home directory is not always root.
    """
    parents = dict.fromkeys((*path.absolute().parents, *path.resolve().parents))
    for parent in parents:
        status = parent.stat()
        if status.st_mode & stat.S_ISVTX:  # there, only its owner can remove or rename a file
            continue
        if status.st_mode & stat.S_IWOTH:
            return parent, "can be written by everybody"
        if status.st_mode & stat.S_IWGRP and not _is_private(status.st_gid):
            return parent, f"can be written by the group {_group(status.st_gid)}"
    return None


def _is_private(group: int) -> bool:
    """Whether a group is root's, or the one that many systems make for each user, of the user's name and alone in it.

    With such groups the usual file mode mask lets the group write.
    """
    if group == 0:
        return True
    try:
        found, own = grp.getgrgid(group), pwd.getpwuid(os.geteuid())
    except KeyError:
        return False
    return found.gr_name == own.pw_name and group == own.pw_gid and set(found.gr_mem) <= {own.pw_name}


def _user(number: int) -> str:
    try:
        return f"the user '{pwd.getpwuid(number).pw_name}'"
    except KeyError:
        return f"the user number {number}"


def _group(number: int) -> str:
    try:
        return f"'{grp.getgrgid(number).gr_name}'"
    except KeyError:
        return f"number {number}"
