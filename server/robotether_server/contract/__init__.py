"""What crosses a border between parts: the objects that the relay fills, other cells pass on, and the API describes.

Only types, and nothing that acts on them. A member that is added later needs a default here: a cell of an older version
does not send it.
"""
