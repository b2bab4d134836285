// Sentences of the pages: the fleet page. No logic beyond filling in.
