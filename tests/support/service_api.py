"""Jobs over HTTP: followed to their end, and problems in their form."""

from __future__ import annotations

import json

PROBLEM = "application/problem+json"


def follow(api, job, **headers):
    """Return the events of a job until its end, by SSE."""
    found = []
    headers = {"Accept": "text/event-stream", **headers}
    with api.stream("GET", f"/api/v1/jobs/{job}/events", headers=headers) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        for line in stream.iter_lines():
            if line.startswith("data: "):
                found.append(json.loads(line[6:]))
    return found


def is_problem(answer, status, kind):
    """Check an answer to be a problem of that kind, and return what it says."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == PROBLEM
    said = answer.json()
    assert said["type"] == f"urn:depthsr:problem:{kind}"
    assert said["status"] == status
    assert said["title"]
    assert said["detail"]
    return said
