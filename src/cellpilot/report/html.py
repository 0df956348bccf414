"""The page: one HTML file without scripts and without anything to load."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from string import Template

from cellpilot.report.figures import FIGURES, Picture
from cellpilot.report.tables import Columns, Row

PAGE = Template(
    """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>$title</title>
<style>
$style
</style>
</head>
<body>
<main>
<h1>$title</h1>
$body
</main>
</body>
</html>
"""
)

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #fff; color: #1b1b1b; font: 1rem/1.5 system-ui, sans-serif; }
main { max-width: 70rem; margin: 0 auto; padding: 1.25rem 1rem 3rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .75rem; overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin: 2.25rem 0 .5rem; border-bottom: 1px solid #ccc; padding-bottom: .2rem; }
p { margin: .5rem 0; max-width: 46rem; }
.scroll { overflow-x: auto; margin: .75rem 0; }
table { border-collapse: collapse; font-size: .875rem; font-variant-numeric: tabular-nums; }
h3 { font-size: 1rem; margin: 1.25rem 0 .25rem; }
th, td { padding: .3rem .5rem; text-align: right; vertical-align: bottom; border-bottom: 1px solid #ddd; }
td { white-space: nowrap; }
thead th { border-bottom: 2px solid #666; font-weight: 600; min-width: 3.6rem; }
th:first-child, td:first-child { text-align: left; }
tbody th { font-weight: 400; white-space: nowrap; }
th:first-child { position: sticky; left: 0; background: #fff; }
tr.published, tr.published th:first-child { background: #f2f2f2; }
dl { display: grid; grid-template-columns: minmax(7rem, max-content) 1fr; gap: .2rem 1rem; font-size: .9rem; margin: .5rem 0; }
dt { font-weight: 600; }
dd { margin: 0; overflow-wrap: anywhere; }
.figures { display: flex; flex-wrap: wrap; gap: 1.5rem; align-items: flex-start; }
figure { margin: 0; max-width: 100%; }
figure .scroll { margin: 0 0 .35rem; }
figure img { display: block; height: auto; }
figcaption { font-size: .875rem; color: #333; contain: inline-size; }
code { font-size: .85em; overflow-wrap: anywhere; }
@media (max-width: 40rem) {
  dl { grid-template-columns: 1fr; gap: 0; }
  dd { margin-bottom: .5rem; }
}
@page { margin: 16mm; }
@media print {
  main { max-width: none; padding: 0; }
  .scroll { overflow: visible; }
  figure, table, dl { break-inside: avoid; }
  h2 { break-after: avoid; }
  html { font-size: 10.5pt; }
  table { font-size: 7.5pt; }
  th, td { padding: .15rem .2rem; }
  thead th { min-width: 0; }
  td, tbody th { white-space: normal; }
  figure img { max-width: 100%; }
}
""".strip()


def page(title: str, sections: Iterable[str]) -> str:
    """The whole document; the sections are HTML already."""
    return PAGE.substitute(title=escape(title), style=STYLE, body="\n".join(sections))


def section(heading: str, *parts: str) -> str:
    """A heading and what stands below it (HTML already)."""
    return "\n".join([f"<section>\n<h2>{escape(heading)}</h2>", *parts, "</section>"])


def paragraph(text: str) -> str:
    """A paragraph of plain text; a number stays on the line of its percent sign."""
    return f"<p>{escape(text)}</p>".replace(" %", "&nbsp;%")


def table(caption: str, headings: Sequence[str], rows: Sequence[Row]) -> str:
    """A table with the policy and the source of its numbers in front; it scrolls sideways where the screen is narrow."""
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in ("policy", "numbers", *headings))
    body = "\n".join(_table_row(row) for row in rows)
    name = escape(caption)
    return (
        f'<h3>{name}</h3>\n<div class="scroll" tabindex="0" role="region" aria-label="{name}"><table aria-label="{name}">\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table></div>"
    )


def _table_row(row: Row) -> str:
    cells = "".join(f"<td>{escape(text)}</td>" for text in (row.source, *row.cells.values()))
    kind = ' class="published"' if row.source == "published" else ""
    return f'<tr{kind}><th scope="row">{escape(row.policy)}</th>{cells}</tr>'


def definitions(pairs: Mapping[str, str]) -> str:
    """A list of terms and what they are."""
    return "<dl>\n" + "\n".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in pairs.items()) + "\n</dl>"


def column_words(columns: Columns) -> str:
    """What each column of the summary table means."""
    return definitions({column.heading: column.long_name for column in columns.values()})


def figures(pictures: Mapping[str, Picture]) -> str:
    """All pictures with number, caption and the thesis's figure."""
    return '<div class="figures">\n' + "\n".join(_figure(i + 1, *item) for i, item in enumerate(pictures.items())) + "\n</div>"


def _figure(number: int, stem: str, picture: Picture) -> str:
    entry = FIGURES[stem]
    beside = f" Compare Figure {entry.thesis_figure} of the thesis." if entry.thesis_figure else ""
    # Its width in inches prints the text at the size it was drawn; a narrow screen scrolls rather than shrinks it.
    source = f"data:image/png;base64,{picture.png_base64}"
    image = f'<img style="width: {picture.width_in:.2f}in" alt="{escape(entry.caption)}" src="{source}">'
    caption = f"<strong>Figure {number}.</strong> {escape(entry.caption + beside)}"
    return f'<figure id="{stem}"><div class="scroll" tabindex="0">{image}</div>\n<figcaption>{caption}</figcaption></figure>'
