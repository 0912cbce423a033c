"""The editor that changes nothing."""

from edit3r.contract import reporting
from edit3r.contract.interfaces import Editor
from edit3r.contract.types import EditRequest, Views


class NoneEditor(Editor):
    """Returns its input: to reconstruct photos as they are, and as the zero of comparisons."""

    def edit(self, views: Views, request: EditRequest) -> Views:
        if request.prompt.strip():
            reporting.warn(
                f"editor 'none' leaves the photos as they are; the prompt {request.prompt!r} is "
                "not used."
            )
        return views
