"""`offpiste inspect`: what a careful engineer would find out first about a log."""

from offpiste.logs.checks.draft import draft_rig
from offpiste.logs.checks.draft_sensors import missing
from offpiste.logs.checks.finding import Finding
from offpiste.logs.checks.inspect import Inspection, inspect_log
from offpiste.logs.checks.text import render, render_text

__all__ = ["Finding", "Inspection", "draft_rig", "inspect_log", "missing", "render", "render_text"]
