"""The page: what it holds, how pictures are carried inside it, and its HTML and Markdown."""

from __future__ import annotations

import base64
import dataclasses
import functools
from collections.abc import Sequence

import jinja2

from soar.report.ablation import Ablation, AblationSettings
from soar.report.judge import Limit, Number
from soar.report.tables import MISSING, Table


@dataclasses.dataclass(frozen=True)
class PublishedRow:
    """Figures of one method as another publication prints them, by metric."""

    method: str
    values: dict[str, float]


@dataclasses.dataclass(frozen=True)
class Published:
    """Rows that stand beside ours, and what has to be known about them."""

    caption: str
    rows: tuple[PublishedRow, ...]
    bor: dict[str, float]


@dataclasses.dataclass(frozen=True)
class ReportSettings:
    """The node ``report``."""

    embed_mb: float
    decimals: int
    limits: dict[str, Limit]
    ablation: AblationSettings
    published: Published


@dataclasses.dataclass(frozen=True)
class Media:
    """A picture or video on the page.

    Attributes:
        kind: ``image`` or ``video``.
        caption: in words; also the text for readers who cannot see it.
        source: data URI, relative link, or empty where the file is missing.
        note: why it is not carried inside the page; empty where it is.
    """

    kind: str
    caption: str
    source: str
    note: str


@dataclasses.dataclass(frozen=True)
class Section:
    """One stage's evidence."""

    anchor: str
    title: str
    media: tuple[Media, ...]
    numbers: tuple[Number, ...]
    remarks: tuple[str, ...]
    missing: tuple[str, ...]
    provenance: str


@dataclasses.dataclass(frozen=True)
class Page:
    """Everything the report says. A table or the ablation is None where there is nothing to put into it."""

    dataset: str
    finished: str
    means: Table | None
    scores: Table | None
    protocol: tuple[tuple[str, str], ...]
    published: Table
    published_caption: str
    bor: Table
    ablation: Ablation | None
    videos: tuple[Media, ...]
    sheets: tuple[Media, ...]
    judged: tuple[Number, ...]
    remarks: tuple[tuple[str, str, str], ...]
    missing: tuple[str, ...]
    sections: tuple[Section, ...]
    costs: Table
    models: Table
    commands: tuple[str, ...]
    decimals: int


class Carrier:
    """Carries files inside the page as long as they fit; first come, first served.

    Args:
        budget: bytes of files, before base64 makes them a third larger.
    """

    def __init__(self, budget: float) -> None:
        self.left = budget

    def carry(self, kind: str, caption: str, data: bytes | None, mime: str, link: str) -> Media:
        """A file as a data URI, as a link beside the page if it does not fit, or as missing if ``data`` is None."""
        if data is None:
            return Media(kind, caption, "", f"missing: {link}")
        if len(data) > self.left:
            return Media(kind, caption, link, f"not carried in the page ({len(data) / 1e6:.1f} MB): {link}")
        self.left -= len(data)
        return Media(kind, caption, f"data:{mime};base64,{base64.b64encode(data).decode()}", "")


def shown(number: Number, digits: int) -> str:
    """A number with its unit, at ``digits`` significant digits."""
    return MISSING if number.value is None else f"{number.value:.{digits}g} {number.unit}".strip()


def limits_in_words(limit: Limit | None) -> str:
    """Which values are fine, and which are not."""
    if limit is None:
        return "not judged"
    fine, beyond = ("≥", "<") if limit.good > limit.bad else ("≤", ">")
    return f"good {fine} {limit.good:g}, bad {beyond} {limit.bad:g}"


def html(page: Page) -> str:
    """The page as one HTML file that needs nothing else."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("soar.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["shown"] = functools.partial(shown, digits=page.decimals)
    environment.filters["limits"] = limits_in_words
    return environment.get_template("page.html").render(page=page)


def markdown(page: Page) -> str:
    """The page's tables and remarks as Markdown, without pictures."""
    judged = Table(
        ("grade", "number", "where", "value", "limits"),
        tuple((n.grade, n.name, n.place, shown(n, page.decimals), limits_in_words(n.limit)) for n in page.judged),
        5,
    )
    parts = [f"# {page.dataset}", f"Newest result: {page.finished}"]
    parts += _part("Missing", "\n".join(f"- `{path}`" for path in page.missing))
    parts += _part("Means", page.means.markdown() if page.means else "No figures.")
    parts += _part("Per camera", page.scores.markdown() if page.scores else "No figures.")
    parts += _part("How it was measured", "\n".join(f"- {name}: {text}" for name, text in page.protocol))
    parts += _part("Published, other data", f"{page.published_caption}\n\n{page.published.markdown()}")
    parts += _part("Body occlusion ratio", page.bor.markdown())
    parts += _part("Ablation", _ablation(page.ablation) if page.ablation else "")
    parts += _part("Health, worst first", judged.markdown() if judged.rows else "No number is judged.")
    parts += _part("Remarks", "\n".join(f"- {place}: {text}" for place, text, _ in page.remarks))
    parts += _part("Run cost", page.costs.markdown())
    parts += _part("Models", page.models.markdown())
    parts += _part("Make it again", "\n".join(["```", *page.commands, "```"]))
    return "\n\n".join(parts) + "\n"


def _ablation(section: Ablation) -> str:
    verdicts = "\n".join(f"- {verdict.words}: {verdict.text}" for verdict in section.verdicts)
    return "\n\n".join((section.note, section.table.markdown(), verdicts))


def _part(heading: str, text: str) -> Sequence[str]:
    return (f"## {heading}", text) if text else ()
