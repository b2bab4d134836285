/*
 * X25519 by libcrypto, in place of OpenSSH's own file of this name. That one is portable reference code, which needed a
 * seventh of the processor time of a log-in at sshd. All key exchanges that sshd_config allows use it.
 */
#include "includes.h"

#include <openssl/evp.h>
#include <string.h>

#define BYTES 32U

int crypto_scalarmult_curve25519(unsigned char *product, const unsigned char *scalar,
                                 const unsigned char *point);

/* Its callers ignore what it returns: kexc25519.c ends the key exchange when the product is all zeros. */
int crypto_scalarmult_curve25519(unsigned char *product, const unsigned char *scalar,
                                 const unsigned char *point)
{
    EVP_PKEY *own = EVP_PKEY_new_raw_private_key(EVP_PKEY_X25519, NULL, scalar, BYTES);
    EVP_PKEY *other = EVP_PKEY_new_raw_public_key(EVP_PKEY_X25519, NULL, point, BYTES);
    EVP_PKEY_CTX *context = own != NULL ? EVP_PKEY_CTX_new(own, NULL) : NULL;
    size_t length = BYTES;
    int made = context != NULL && other != NULL && EVP_PKEY_derive_init(context) == 1 &&
               EVP_PKEY_derive_set_peer(context, other) == 1 &&
               EVP_PKEY_derive(context, product, &length) == 1 && length == BYTES;

    EVP_PKEY_CTX_free(context);
    EVP_PKEY_free(other);
    EVP_PKEY_free(own);
    if (!made)
        memset(product, 0, BYTES);
    return made ? 0 : -1;
}
