"""Markdown as HTML, and what is found in it."""

from labrig.report.markdown import find_fences, find_headings, find_links, find_prose, make_html, parse

PAGE = """\
# Camera & lens

See [the bench](../bench.md#axes), `a_b` and
![a board](board.svg).

## Options: `--px`

## Options: `--px`

| key | value |
|---|---|
| a | b |

- an entry

```sh bench
labrig check
```
"""


def test_html_in_markdown_stays_text() -> None:
    """Neither a tag, nor an attribute, nor an address that runs a script gets through."""
    text = "<script>alert(1)</script>\n\n[x](javascript:alert(1)) <b onclick=x>\n\n![x](data:text/html,y)"
    html = make_html(parse(text), lambda address: address)
    assert "&lt;script&gt;" in html
    assert not {"<script", "<b ", "href=", "src="} & {
        word for word in ("<script", "<b ", "href=", "src=") if word in html
    }


def test_headings_have_anchors_of_their_own() -> None:
    """As GitHub and MyST make them, numbered where two headings are the same."""
    headings = find_headings(parse(PAGE))
    assert [heading.anchor for heading in headings] == ["camera--lens", "options---px", "options---px-1"]
    html = make_html(parse(PAGE), lambda address: address)
    assert all(f'id="{heading.anchor}"' in html for heading in headings)


def test_links_pictures_fences_and_prose_are_found() -> None:
    """Each once; headings, tables and code are no prose."""
    tokens = parse(PAGE)
    assert list(find_links(tokens)) == ["../bench.md#axes", "board.svg"]
    assert [(fence.info, fence.text) for fence in find_fences(tokens)] == [("sh bench", "labrig check\n")]
    assert list(find_prose(tokens)) == ["See the bench, a_b and .", "an entry"]


def test_addresses_are_changed() -> None:
    """Those of links and of pictures."""
    html = make_html(parse("[a](b.md) ![c](d.svg)"), lambda address: f"new/{address}")
    assert 'href="new/b.md"' in html
    assert 'src="new/d.svg"' in html
