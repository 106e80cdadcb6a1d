"""The page in the browser that explores basins of attraction, and its server.

`server` answers the requests of the page (`page/`, JavaScript by hand) by functions of `pictures`,
`walks`, `measures` and `copies`; `guard` refuses those of others.
"""
