"""The page: limits as sliders, the optimum solved while they are dragged.

`controls` derives the sliders from the scene. `service` holds a scene with its taps and solves it under other limits;
`opening` creates it from a scene, a library or a user's own taps, and `shown` is one tap of its answer. `question`
searches the limit that an error needs. `session` handles the requests of one window, `frames` encodes its messages,
`fields` words its refusals, and `server` serves it to a browser on this machine. The web server is not imported
before a page is opened. (The package is not called `page`, the name of the function `transopt.page`.)
"""
