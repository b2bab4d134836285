// Sentences of the pages: how old things are and why driving is held. No logic beyond filling in.
