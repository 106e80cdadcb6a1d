"""The page in the browser that explores basins of attraction, and its server.

`server` serves the page (`page/`, handwritten JavaScript). `service` answers its requests with
functions of `pictures`, `walks`, `measures` and `copies`. `guard` refuses the requests of others.
"""
