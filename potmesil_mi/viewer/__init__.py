"""The viewer: a picture that one refocuses by a click, in a notebook or in a browser."""
