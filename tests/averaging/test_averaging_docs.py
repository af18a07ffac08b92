"""The example of docs/averaging.md runs and says what it should."""

import re
from pathlib import Path


def test_example_of_the_docs_runs(capsys):
    text = (Path(__file__).parents[2] / "docs" / "averaging.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(code, "docs/averaging.md", "exec"), {})
    said = capsys.readouterr().out
    flagged = int(re.search(r"True True (\d+) of 1500", said).group(1))
    assert 140 <= flagged <= 155
