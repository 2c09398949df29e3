"""Read HTML files that dcgrid writes."""

from html.parser import HTMLParser

VOID = {"meta", "img", "br"}


class Balanced(HTMLParser):
    """Checks that every tag is closed, and keeps the text, the tags and the links to other files."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text, self.links = [], set(), [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.links += [to for name, to in attrs if name in ("src", "href") and not (to or "").startswith("data:")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)
