"""The page: limits as sliders, the optimum solved while they are dragged.

`controls` derives the sliders from the scene, `service` holds a scene with its taps and solves it under other limits,
`question` asks which limit an error needs, `session` is one window's conversation in the `frames` that it goes by,
`server` serves it to a browser on this machine, and `figure` draws a service without one. Nothing here loads the web
server or plotly before a page is asked for. (The room is not called `page`: that is the function `transopt.page`.)
"""
