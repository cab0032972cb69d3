"""The tracker on other people's libraries: slower, and witnesses of the fast backends; see `tracker.backends`.

The only modules of the services that import scikit-learn and filterpy. They are imported only when chosen.
"""
