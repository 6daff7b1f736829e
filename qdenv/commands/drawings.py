"""Commands about what layout files look like: render, layout symbols."""

from pathlib import Path

from qdenv.commands import output
from qdenv.commands.choices import DomainName, LayoutFile
from qdenv.domains.base import DOMAINS, Domain, find_domain
from qdenv.io.layouts import aliases
from qdenv.study.plans import read_plan


def render(layout: LayoutFile, domain: DomainName = None, out: Path | None = None) -> None:
    """Draw a layout as a picture: PNG, SVG or PDF.

    Args:
        layout: layout file.
        domain: whose layout; what the file says, or its tiles tell, unless given.
        out: picture to write; named after the layout file unless given.
    """
    plan = read_plan(layout, domain)
    place = output.place(out, f"{layout.stem}.png", output.PICTURES, [layout])
    # Only here: matplotlib takes half a second to import, and who is refused need not wait.
    from qdenv.view.layouts import save_layout

    save_layout(place.path, plan.layout, plan.domain.tiles, plan.domain.names)
    rows, cols = plan.layout.shape
    print(f"{place}: {rows} x {cols}, {plan.whose}")


def layout_symbols(domain: DomainName = None) -> None:
    """List the symbols of layout files: what each means in each domain.

    Args:
        domain: only this one.
    """
    shown: dict[tuple[tuple[str, ...], ...], list[str]] = {}
    for name in (domain,) if domain else DOMAINS.names():
        shown.setdefault(tuple(rows_of(find_domain(name))), []).append(name)
    head = ("symbol", "tile", "robots", "also", "meaning")
    for rows, names in shown.items():
        widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
        print(", ".join(names))
        for row in (head, *rows):
            cells = (f"{cell:{width}}" for cell, width in zip(row, widths, strict=True))
            print(f"  {'  '.join(cells)}".rstrip())
        print()


def rows_of(domain: Domain) -> list[tuple[str, ...]]:
    """List a domain's tiles: symbol, name, whether robots drive there, other symbols, meaning."""
    also: dict[str, list[str]] = {}
    for other, symbol in aliases(domain.tiles, domain.meanings).items():
        also.setdefault(symbol, []).append(repr(other))
    rows: list[tuple[str, ...]] = []
    for symbol in domain.tiles:
        tile = domain.meanings.get(symbol)
        if tile is None:
            rows.append((repr(symbol), "", "", " ".join(also.get(symbol, [])), ""))
            continue
        drives = "drive around it" if tile.obstacle else "drive over it"
        rows.append((repr(symbol), tile.name, drives, " ".join(also.get(symbol, [])), tile.about))
    return rows
