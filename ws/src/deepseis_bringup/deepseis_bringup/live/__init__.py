"""The live page: what a running graph says, held in bounded memory and streamed to browsers.

`model` takes the values of topics, `frames` gives a browser what it has not yet got, `server` is
the web server. None of them knows ROS; `deepseis_bringup.nodes.web` feeds them.
"""
