/*
 * Ed25519 by libcrypto, in place of OpenSSH's own file of this name.
 *
 * That one is portable reference code, which needed a seventh of the processor time of a log-in at sshd. Newer OpenSSH
 * than Debian's leaves Ed25519 to libcrypto, too. sshd signs with its host key here, and checks the signatures of
 * robots and people: crypto_sign_ed25519_open must never return 0 for a signature that is not good.
 */
#include "includes.h"

#include <openssl/evp.h>
#include <string.h>

#include "crypto_api.h"

#define SEED_BYTES 32U
#define PUBLIC_BYTES crypto_sign_ed25519_PUBLICKEYBYTES
#define SIGNATURE_BYTES crypto_sign_ed25519_BYTES

/* A secret key is its seed with the public key behind it. */
int crypto_sign_ed25519_keypair(unsigned char *public, unsigned char *secret)
{
    EVP_PKEY *key;
    size_t length = PUBLIC_BYTES;
    int made;

    randombytes(secret, SEED_BYTES);
    key = EVP_PKEY_new_raw_private_key(EVP_PKEY_ED25519, NULL, secret, SEED_BYTES);
    made = key != NULL && EVP_PKEY_get_raw_public_key(key, public, &length) == 1 &&
           length == PUBLIC_BYTES;
    EVP_PKEY_free(key);
    if (!made)
        return -1;
    memcpy(secret + SEED_BYTES, public, PUBLIC_BYTES);
    return 0;
}

/* A signed message is the signature with the message behind it. */
int crypto_sign_ed25519(unsigned char *signed_message, unsigned long long *signed_length,
                        const unsigned char *message, unsigned long long length,
                        const unsigned char *secret)
{
    EVP_PKEY *key = EVP_PKEY_new_raw_private_key(EVP_PKEY_ED25519, NULL, secret, SEED_BYTES);
    EVP_MD_CTX *context = EVP_MD_CTX_new();
    size_t written = SIGNATURE_BYTES;
    int made = key != NULL && context != NULL &&
               EVP_DigestSignInit(context, NULL, NULL, NULL, key) == 1 &&
               EVP_DigestSign(context, signed_message, &written, message, length) == 1 &&
               written == SIGNATURE_BYTES;

    EVP_MD_CTX_free(context);
    EVP_PKEY_free(key);
    if (!made)
        return -1;
    memcpy(signed_message + SIGNATURE_BYTES, message, length);
    *signed_length = length + SIGNATURE_BYTES;
    return 0;
}

/* 0 and the message if the signature is good. */
int crypto_sign_ed25519_open(unsigned char *message, unsigned long long *length,
                             const unsigned char *signed_message, unsigned long long signed_length,
                             const unsigned char *public)
{
    EVP_PKEY *key = EVP_PKEY_new_raw_public_key(EVP_PKEY_ED25519, NULL, public, PUBLIC_BYTES);
    EVP_MD_CTX *context = EVP_MD_CTX_new();
    /* OpenSSH hands on signatures that are too short, too. */
    int good = signed_length >= SIGNATURE_BYTES && key != NULL && context != NULL &&
               EVP_DigestVerifyInit(context, NULL, NULL, NULL, key) == 1 &&
               EVP_DigestVerify(context, signed_message, SIGNATURE_BYTES,
                                signed_message + SIGNATURE_BYTES,
                                signed_length - SIGNATURE_BYTES) == 1;

    EVP_MD_CTX_free(context);
    EVP_PKEY_free(key);
    if (!good) {
        *length = (unsigned long long)-1;
        return -1;
    }
    *length = signed_length - SIGNATURE_BYTES;
    memcpy(message, signed_message + SIGNATURE_BYTES, *length);
    return 0;
}
