"""Living pictures: one page of HTML with a picture that whoever opens it refocuses."""
