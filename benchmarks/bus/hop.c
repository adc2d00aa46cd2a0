/* One party of the yardstick: a publisher, a relay or a subscriber with nothing in between but libmosquitto.
 *
 *   hop pub   PORT USER TOPIC RATE_HZ COUNT BYTES   stamps each payload and publishes it when it is due
 *   hop relay PORT USER FROM TO                     passes each payload on
 *   hop sub   PORT USER TOPIC COUNT                 prints the age of each payload in nanoseconds
 *
 * It does the least that a program on the bus can do: MQTT 3.1.1, QoS 0, TCP_NODELAY, no thread, no decoding.
 */
#define _GNU_SOURCE
#include <mosquitto.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { KEEP_ALIVE_S = 60, PAYLOAD_MAX = 4096, WAITING_MAX = 64, POLL_MS = 100 };

struct payload {
    int size;
    unsigned char bytes[PAYLOAD_MAX];
};

static volatile int connected, received;
static const char *subscription;
static struct payload waiting[WAITING_MAX];
static int waiting_count;
static int64_t *ages_ns;
static int expected;

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void fail(const char *what, int code)
{
    fprintf(stderr, "%s: %s\n", what, mosquitto_strerror(code));
    exit(1);
}

static void on_connect(struct mosquitto *client, void *unused, int code)
{
    (void)unused;
    if (code)
        fail("connect", code);
    if (subscription)
        mosquitto_subscribe(client, NULL, subscription, 0);
    else
        connected = 1;
}

static void on_subscribe(struct mosquitto *client, void *unused, int id, int count, const int *granted)
{
    (void)client, (void)unused, (void)id;
    if (count != 1 || granted[0] > 2) {
        fprintf(stderr, "the broker refuses the subscription to %s\n", subscription);
        exit(1);
    }
    connected = 1;
    puts("ready");
    fflush(stdout);
}

static void on_measured(struct mosquitto *client, void *unused, const struct mosquitto_message *message)
{
    int64_t sent_ns;
    (void)client, (void)unused;
    memcpy(&sent_ns, message->payload, sizeof sent_ns);
    if (received < expected)
        ages_ns[received++] = now_ns() - sent_ns;
}

static void on_relayed(struct mosquitto *client, void *unused, const struct mosquitto_message *message)
{
    (void)client, (void)unused;
    if (waiting_count < WAITING_MAX && message->payloadlen <= PAYLOAD_MAX) {
        struct payload *next = &waiting[waiting_count++];
        next->size = message->payloadlen;
        memcpy(next->bytes, message->payload, (size_t)message->payloadlen);
    }
}

static void turn(struct mosquitto *client, int timeout_ms)
{
    int code = mosquitto_loop(client, timeout_ms, 1);
    if (code)
        fail("loop", code);
}

static struct mosquitto *join(const char *port, const char *user, const char *topic)
{
    struct mosquitto *client = mosquitto_new(NULL, 1, NULL);
    int code;
    subscription = topic;
    mosquitto_int_option(client, MOSQ_OPT_PROTOCOL_VERSION, MQTT_PROTOCOL_V311);
    mosquitto_int_option(client, MOSQ_OPT_TCP_NODELAY, 1);
    mosquitto_username_pw_set(client, user, NULL);
    mosquitto_connect_callback_set(client, on_connect);
    mosquitto_subscribe_callback_set(client, on_subscribe);
    if ((code = mosquitto_connect(client, "127.0.0.1", atoi(port), KEEP_ALIVE_S)))
        fail("connect", code);
    while (!connected)
        turn(client, POLL_MS);
    return client;
}

static void publish(char **arguments)
{
    struct mosquitto *client = join(arguments[0], arguments[1], NULL);
    int64_t period_ns = (int64_t)(1e9 / atof(arguments[3]));
    int count = atoi(arguments[4]), size = atoi(arguments[5]);
    static unsigned char bytes[PAYLOAD_MAX];
    int64_t due_ns = now_ns();
    for (int i = 0; i < count; i++) {
        struct timespec due;
        int64_t stamp_ns;
        due_ns += period_ns;
        due.tv_sec = due_ns / 1000000000;
        due.tv_nsec = due_ns % 1000000000;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        stamp_ns = now_ns();
        memcpy(bytes, &stamp_ns, sizeof stamp_ns);
        mosquitto_publish(client, NULL, arguments[2], size, bytes, 0, false);
        turn(client, 0);
    }
    turn(client, POLL_MS);
    mosquitto_disconnect(client);
    mosquitto_loop(client, POLL_MS, 1);
}

static void relay(char **arguments)
{
    struct mosquitto *client = join(arguments[0], arguments[1], arguments[2]);
    mosquitto_message_callback_set(client, on_relayed);
    for (;;) {
        turn(client, POLL_MS);
        for (int i = 0; i < waiting_count; i++)
            mosquitto_publish(client, NULL, arguments[3], waiting[i].size, waiting[i].bytes, 0, false);
        waiting_count = 0;
    }
}

static void subscribe(char **arguments)
{
    struct mosquitto *client = join(arguments[0], arguments[1], arguments[2]);
    expected = atoi(arguments[3]);
    ages_ns = calloc((size_t)expected, sizeof *ages_ns);
    mosquitto_message_callback_set(client, on_measured);
    while (received < expected)
        turn(client, POLL_MS);
    for (int i = 0; i < expected; i++)
        printf("%lld\n", (long long)ages_ns[i]);
}

int main(int count, char **arguments)
{
    mosquitto_lib_init();
    if (count == 8 && !strcmp(arguments[1], "pub"))
        publish(arguments + 2);
    else if (count == 6 && !strcmp(arguments[1], "relay"))
        relay(arguments + 2);
    else if (count == 6 && !strcmp(arguments[1], "sub"))
        subscribe(arguments + 2);
    else
        return 2;
    return 0;
}
