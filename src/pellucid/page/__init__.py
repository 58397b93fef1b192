"""The real-time page: a model and three stages of WebGL2 in one file, for any browser."""
