"""The notebooks as pages, with the outputs that their files hold. Nothing is executed."""

import base64
import json
from pathlib import Path

from mkdocs.structure.files import File

NOTEBOOKS = Path(__file__).parent.parent.parent / "notebooks"


def on_files(files, *, config):
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        text, pictures = page_of(json.loads(path.read_text()), path.stem)
        text += f"\n*This page shows `notebooks/{path.name}`.*\n"
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        for name, content in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def page_of(notebook: dict, stem: str) -> tuple[str, dict[str, bytes]]:
    """A notebook in Markdown, and its pictures by the names that the text has for them."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            kind = next((kind for kind in ("png", "gif") if f"image/{kind}" in data), None)
            if kind:
                name = f"{stem}-{len(pictures) + 1}.{kind}"
                pictures[name] = base64.b64decode(data[f"image/{kind}"])
                parts.append(f"![Output of the program above]({name})")
            else:
                text = "".join(output.get("text", data.get("text/plain", "")))
                parts.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(parts) + "\n", pictures
