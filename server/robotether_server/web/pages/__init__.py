"""The pages for everybody: a module a page, each with a blueprint that app.py registers."""
