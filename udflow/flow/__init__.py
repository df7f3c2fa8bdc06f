"""The method's equations (1) to (5), for any velocity v(x, t). No field and no network inside.

Time runs from t = 0 on the surface to t = 1 at the query.
"""
