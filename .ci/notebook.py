"""The notebook as a page of the site: cells, printed text, tables and pictures, no script."""

import json
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

NAME = "notebook"
LINK = "\n[As a file for Jupyter](notebook.ipynb)\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page beside the notebook itself, which is copied as it is."""
    cells = json.loads((Path(config.docs_dir) / f"{NAME}.ipynb").read_text())["cells"]
    title, *rest = cells
    text = "\n".join([markdown(title), LINK, *map(markdown, rest)])
    files.append(File.generated(config, f"{NAME}.md", content=text))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Lead links to the notebook to its page."""
    return markdown if LINK in markdown else markdown.replace(f"({NAME}.ipynb)", f"({NAME}.md)")


def markdown(cell: dict) -> str:
    """One cell with its outputs."""
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        return f"{source}\n"
    return "\n".join([f"```python\n{source}\n```\n", *map(shown, cell["outputs"])])


def shown(output: dict) -> str:
    """One output: a picture, a table, or text."""
    data = output.get("data", {})
    if "image/png" in data:
        picture = "".join(data["image/png"]).strip()
        return f'<img alt="the plot" src="data:image/png;base64,{picture}">\n'
    if "text/html" in data:
        table = "".join(data["text/html"]).replace(' class="dataframe"', "")  # the theme's own look
        lines = table.splitlines()
        return "\n".join(line for line in lines if line.strip()) + "\n"
    text = "".join(data.get("text/plain", output.get("text", "")))
    return f"```text\n{text.rstrip()}\n```\n"
