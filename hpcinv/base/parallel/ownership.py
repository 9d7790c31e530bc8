"""Check whether users other than root and the current user could have written a file or directory."""

import grp
import os
import pwd
import stat
from pathlib import Path


def foreign_writer(status: os.stat_result) -> str:
    """Reason why another user could have written a file with this ``status``; empty text if none could.

    Access control lists are included in the group bits of the mode, which are the most that they allow.
    """
    if status.st_uid not in (0, os.geteuid()):
        return f"belongs to {_user(status.st_uid)}"
    return _open_to_others(status)


def foreign_writer_above(path: Path) -> tuple[Path, str] | None:
    """Directory above ``path`` in which another user could replace it, and the reason; ``None`` if there is none.

    The owners of these directories are not checked: the parent of home directories does not always belong to root.
    """
    parents = dict.fromkeys((*path.absolute().parents, *path.resolve().parents))
    for parent in parents:
        status = parent.stat()
        is_sticky = status.st_mode & stat.S_ISVTX  # only the owner can remove or rename a file there
        if not is_sticky and (reason := _open_to_others(status)):
            return parent, reason
    return None


def _open_to_others(status: os.stat_result) -> str:
    if status.st_mode & stat.S_IWOTH:
        return "can be written by everybody"
    if status.st_mode & stat.S_IWGRP and not _is_private(status.st_gid):
        return f"can be written by the group {_group(status.st_gid)}"
    return ""


def _is_private(group: int) -> bool:
    """Return whether a group is root's, or the private group of the user with the same name and no other member.

    Many systems make such groups, with a file mode mask that lets the group write.
    """
    if group == 0:
        return True
    try:
        group_entry, own = grp.getgrgid(group), pwd.getpwuid(os.geteuid())
    except KeyError:
        return False
    return group_entry.gr_name == own.pw_name and group == own.pw_gid and set(group_entry.gr_mem) <= {own.pw_name}


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
