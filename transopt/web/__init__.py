"""The page: limits as sliders, the optimum solved while they are dragged.

`controls` derives the sliders from the scene, `service` holds a scene with its taps and solves it under other limits,
`opening` makes one of a scene, a library or a user's own taps, and `shown` is one tap of an answer. `question` asks
which limit an error needs. `session` is one window's conversation in the `frames` that it goes by, in the words of
`fields`, and `server` serves it to a browser on this machine. Nothing here loads the web server before a page is
asked for. (The room is not called `page`: that is the function `transopt.page`.)
"""
