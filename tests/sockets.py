"""Which addresses processes listen on or send from, as the kernel tells."""

import os
import re
import socket
import struct
from pathlib import Path


def family(pid):
    """A process and all that it started."""
    found = [pid]
    for number in found:
        for task in Path(f"/proc/{number}/task").glob("*/children"):
            found += [int(child) for child in task.read_text().split()]
    return found


def internet_addresses(pids):
    """Local addresses of all internet sockets of these processes."""
    inodes = set()
    for pid in pids:
        for item in Path(f"/proc/{pid}/fd").iterdir():
            try:
                match = re.match(r"socket:\[(\d+)\]", os.readlink(item))
            except OSError:
                continue
            inodes |= {match[1]} if match else set()
    found = set()
    for table in ("udp", "tcp", "udp6", "tcp6", "raw", "raw6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[9] in inodes:
                found.add(_address(words[1].partition(":")[0]))
    return found


def _address(text):
    words = [struct.pack("<I", int(text[i : i + 8], 16)) for i in range(0, len(text), 8)]
    kind = socket.AF_INET if len(words) == 1 else socket.AF_INET6
    return socket.inet_ntop(kind, b"".join(words))
