/* What passes between authorized-keys, which asks, and key-lookups, which answers. */
#ifndef KEY_LOOKUPS_H
#define KEY_LOOKUPS_H

/* A datagram each way. Only the account `keylookup` may ask. */
#define SOCKET "/run/robotether/key-lookups/socket"

/* The question: FINGERPRINT and CONNECTION, each with its final zero byte; or RENEW_CACHE alone. */
#define RENEW_CACHE "cache"
#define QUESTION_SIZE 512

/* The answer: a letter, and behind LET_IN the key's line. */
#define LET_IN 'y'
#define KEEP_OUT 'n'
#define RENEWED 'r'
#define CANNOT_TELL '?'
#define LINE_SIZE 4096

#endif
