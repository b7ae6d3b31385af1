"""The page: limits as sliders, the optimum solved while they are dragged.

`controls` derives the sliders from the scene, `session` holds a scene with its taps and solves it under other limits,
`inverse` asks which limit meets an error, `figure` draws a session without a browser, `server` serves all of it to a
browser on this machine. Nothing here loads the web server or plotly before a page is asked for.
"""
