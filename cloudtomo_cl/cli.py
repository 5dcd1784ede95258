"""The command line: what `cloudtomo` understands. The work is in commands.py."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from cloudtomo_cl import cloud_command, init_command, validate_command
