"""Reads what `deploy` has for containers and writes it as JSON.

    deployed.py yaml FILE             the documents of a YAML file
    deployed.py chart FOLDER VALUES   what Helm makes of a chart with values (JSON), and what its linter says
"""

import json
import sys
from pathlib import Path

import yaml


def documents(text: str) -> list[object]:
    return [document for document in yaml.safe_load_all(text) if document is not None]


def chart(folder: str, values: str) -> dict[str, object]:
    from helm_python import Chart, HelmError
    from helm_python.chart import lint

    given = json.loads(values)
    try:
        report = lint(folder, given, strict=True)
        rendered = Chart.load(folder).render(given, name="pliant", namespace="studio")
    except HelmError as problem:
        return {"problem": str(problem)}
    # Informations are severity 1.
    found = [message for message in report["messages"] if message["severity"] > 1]
    notes = next(text for name, text in rendered.items() if name.endswith("NOTES.txt"))
    manifests = [text for name, text in sorted(rendered.items()) if name.endswith(".yaml")]
    return {
        "lint": [*found, *report["errors"]],
        "notes": notes,
        "text": "\n---\n".join(manifests),
        "documents": [document for text in manifests for document in documents(text)],
    }


if __name__ == "__main__":
    result = documents(Path(sys.argv[2]).read_text()) if sys.argv[1] == "yaml" else chart(*sys.argv[2:])
    json.dump(result, sys.stdout)
