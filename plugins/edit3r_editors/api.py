"""What other plugins may use of this one."""

from edit3r_editors.mock_diffusion import with_look

__all__ = ["with_look"]
