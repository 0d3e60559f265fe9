"""What stands on pages: blocks of code, and the command lines in them."""

import re


def blocks(page, language):
    """(first line, text) of the blocks of code on a page."""
    text = page.read_text(encoding="utf-8")
    return [
        (text[: block.start(1)].count("\n"), block[1])
        for block in re.finditer(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    ]


def command_lines(text):
    """The lines that call ``potmesil``, with those on which they go on."""
    whole = re.sub(r"\\\n\s*", "", text)
    return [line.strip() for line in whole.splitlines() if line.strip().startswith("potmesil ")]
