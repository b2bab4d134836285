// Sentences of the pages: what a person drives with. No logic beyond filling in.
