"""The live page: a host that shows clouds and skeletons in a browser, frame by frame.

`LivePage` is all that a caller needs: `show` a frame, `finish`, `serve`. It runs no
pipeline of its own; a frame brings along what makes it again.
"""
