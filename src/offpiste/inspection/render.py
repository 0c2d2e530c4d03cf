"""Text rendering of an inspection."""

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import Inspection

_STYLE = {"fatal": "bold red", "warning": "yellow", "note": "dim"}


def render(inspection: Inspection) -> RenderableType:
    """Return the header, topics, findings and verdict for `rich.print`."""
    parts: list[RenderableType] = [Text(_headline(inspection), style="bold"), _topics(inspection)]
    parts += [Text(f"reader: {message}", style="dim") for message in inspection.warnings]
    if inspection.findings:
        parts += [_finding(i, finding) for i, finding in enumerate(inspection.findings, start=1)]
    else:
        parts.append(Text("nothing to fix"))
    parts.append(_verdict(inspection))
    return Group(*parts)


def render_text(inspection: Inspection, *, width: int = 120) -> str:
    """Return an inspection as plain text."""
    console = Console(width=width, no_color=True, highlight=False)
    with console.capture() as capture:
        console.print(render(inspection))
    return capture.get()


def _headline(inspection: Inspection) -> str:
    summary = inspection.summary
    read = f"through rig '{inspection.rig}'" if inspection.rig else "without a rig: channels are guessed"
    text = f"{inspection.log}, {read}\n{summary.duration:.1f} s"
    if summary.distance is not None:
        text += (
            f", {summary.distance:.0f} m; speed {summary.speed_median:.1f} m/s median, {summary.speed_p95:.1f} m/s at "
            f"95 %, {summary.speed_max:.1f} m/s at most; at a standstill {summary.standing:.0%} of the time"
        )
    return text


def _topics(inspection: Inspection) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("topic", "type"):
        table.add_column(name, overflow="fold")
    for name in ("samples", "Hz", "s"):
        table.add_column(name, justify="right")
    for row in inspection.topics:
        rate = "" if row.rate is None else f"{row.rate:.1f}"
        seconds = "" if row.seconds is None else f"{row.seconds:.1f}"
        table.add_row(row.name, row.type, str(row.count), rate, seconds)
    return table


def _finding(index: int, finding: Finding) -> Text:
    text = Text(f"\n{index}. ")
    text.append(finding.severity, style=_STYLE[finding.severity])
    text.append(f"  {finding.where}: {finding.what}\n", style="bold" if finding.severity != "note" else "")
    text.append(f"   seen: {finding.evidence}\n")
    if finding.also:
        text.append(f"   also: {'; '.join(finding.also)}\n")
    text.append("   fix: ")
    text.append(finding.remedy, style="cyan")
    return text


def _verdict(inspection: Inspection) -> Text:
    count = {s: sum(f.severity == s for f in inspection.findings) for s in _STYLE}
    message = ", ".join(f"{n} {name}{'s' if n > 1 and name != 'fatal' else ''}" for name, n in count.items() if n)
    verdict = "usable for training" if inspection.usable else "NOT usable for training"
    if not inspection.usable and all(finding.cures for finding in inspection.findings if finding.severity == "fatal"):
        verdict += " until cured as said above"
    return Text(
        f"\n{verdict}" + (f" ({message})" if message else ""), style="bold green" if inspection.usable else "bold red"
    )
