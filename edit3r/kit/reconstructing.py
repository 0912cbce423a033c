"""A reconstructor together with who reads the geometry that it uses."""

from dataclasses import dataclass

from edit3r.contract.interfaces import FindsGeometry, Geometry, Matcher, Reconstructor
from edit3r.contract.types import Reconstruction, Views
from edit3r.kit import asking


@dataclass(frozen=True)
class WithMatcher:
    """A reconstructor whose geometry, where it uses any, a matcher reads from the source views.

    What runs do step by step, in one call, for whoever measures or fits reconstructions.
    """

    reconstructor: Reconstructor
    matcher: Matcher

    def geometry(self, source: Views) -> Geometry | None:
        """What the reconstructor is given of `source`; None where it uses no geometry.

        Raises MatchingError when the photos cannot be placed relative to each other.
        """
        if isinstance(self.reconstructor, FindsGeometry):
            return asking.find_geometry(self.reconstructor, source)
        if not self.reconstructor.uses_geometry:
            return None
        return asking.find_geometry(self.matcher, source)

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        """Reconstruct `views`; geometry is read from `source`, where given, as edits disagree."""
        source = views if source is None else source
        recon, geometry = self.reconstructor, self.geometry(source)
        return asking.reconstruct(
            recon, views, lambda: recon(views, source, geometry, grid)
        )
