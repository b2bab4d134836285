"""What crosses a border between parts: objects that the relay fills, other cells pass on and the API describes; codes.

Types and tables, and the sentences made of them. A member that is added later needs a default here: a cell of an older
version does not send it.
"""
