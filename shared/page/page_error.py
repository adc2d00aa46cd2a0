"""An error of the program of a page, as the browser reports it."""

from pydantic import BaseModel, ConfigDict, Field


class PageError(BaseModel):
    """An error that no part of a page expected."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    page: str = Field(max_length=40, description="part of the dashboard, such as gnss or banner")
    message: str = Field(max_length=400, description="the error, as the browser words it")
    place: str = Field(default="", max_length=400, description="file, line and column, innermost first")

    @property
    def sentence(self) -> str:
        """The error on one line; the text is the visitor's, so control characters are escaped."""
        at = f" at {self.place!a}" if self.place else ""
        return f"page {self.page!a}: {self.message!a}{at}"[:400]
