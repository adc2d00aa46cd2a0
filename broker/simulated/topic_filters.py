"""Topic names and filters (OASIS MQTT 3.1.1, section 4.7)."""

MAX_LEVELS = 200  # as Mosquitto: matching takes time with each level


def is_name(topic: str) -> bool:
    """Whether a message may be published to this topic."""
    return len(topic) > 0 and topic.count("/") < MAX_LEVELS and "+" not in topic and "#" not in topic


def is_filter(topic: str) -> bool:
    """Whether one may subscribe to this: + fills a level, # fills the last one."""
    *first, last = topic.split("/")
    return (
        len(topic) > 0
        and len(first) < MAX_LEVELS
        and all(level == "+" or ("+" not in level and "#" not in level) for level in first)
        and (last in ("+", "#") or ("+" not in last and "#" not in last))
    )


def matches(pattern: str, topic: str) -> bool:
    """Whether a filter takes a topic; wildcards in the first level never take one that begins with $."""
    if topic[0] == "$" and pattern[0] in "+#":
        return False
    wanted = pattern.split("/")
    levels = topic.split("/")
    if wanted[-1] == "#":
        wanted.pop()
        levels = levels[: len(wanted)]
    return len(wanted) == len(levels) and all(w in ("+", level) for w, level in zip(wanted, levels, strict=True))


def overlap(one: str, other: str) -> bool:
    """Whether some topic is taken by both filters."""
    ones, others = one.split("/"), other.split("/")
    for a, b in zip(ones, others, strict=False):
        if "#" in (a, b):
            return True
        if "+" not in (a, b) and a != b:
            return False
    longer = ones[len(others) :] or others[len(ones) :]
    return longer in ([], ["#"])
