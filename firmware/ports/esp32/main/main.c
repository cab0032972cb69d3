/* The beacon on an ESP32, C3 or S3 (ESP-IDF 5.5.2 or newer). It has been compiled and run against fakes of the peripherals on
 * a host (firmware/fakes/esp_idf); never on silicon. docs/beacon.md says how to check it with a logic analyser.
 *
 *   LED_GPIO   the LED's driver, lit = high (menuconfig: Heliograph)
 *   UART 0     115 200 baud, the USB bridge of most boards; the console's output is off (sdkconfig.defaults)
 *   NVS        namespace "heliograph", blob "program"
 */
#include <string.h>

#include "driver/uart.h"
#include "esp_mac.h"
#include "esp_random.h"
#include "esp_system.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "hg_beacon.h"
#include "nvs.h"
#include "nvs_flash.h"
#include "rmt_light.h"
#include "sdkconfig.h"

#define LINE UART_NUM_0
#define LINE_BUFFER 1024
#define BAUD 115200
#define US_PER_MS 1000
#define SPACE "heliograph"
#define KEY "program"
/* Below 50 bit/s nobody asks; above 10 kbit/s the interrupt would come every 3 ms. */
#define RATE_LEAST 50000u
#define RATE_MOST 10000000u

static hg_beacon beacon;

static uint32_t now_ms(void)
{
    return (uint32_t)(esp_timer_get_time() / US_PER_MS);
}

static bool write_line(void *context, const uint8_t *bytes, size_t n)
{
    (void)context;
    size_t room = 0;
    if (uart_get_tx_buffer_free_size(LINE, &room) != ESP_OK || room < n) {
        return false;
    }
    return uart_write_bytes(LINE, bytes, n) == (int)n;
}

static bool save(void *context, const uint8_t *bytes, size_t n)
{
    (void)context;
    nvs_handle_t store;
    if (nvs_open(SPACE, NVS_READWRITE, &store) != ESP_OK) {
        return false;
    }
    const bool kept = nvs_set_blob(store, KEY, bytes, n) == ESP_OK && nvs_commit(store) == ESP_OK;
    nvs_close(store);
    return kept;
}

static size_t load(void *context, uint8_t *bytes)
{
    (void)context;
    nvs_handle_t store;
    size_t n = HG_STORE_MOST;
    if (nvs_open(SPACE, NVS_READONLY, &store) != ESP_OK) {
        return 0;
    }
    const bool found = nvs_get_blob(store, KEY, bytes, &n) == ESP_OK;
    nvs_close(store);
    return found ? n : 0;
}

static enum hg_reset reset_reason(void)
{
    switch (esp_reset_reason()) {
    case ESP_RST_POWERON:
        return HG_RESET_POWER;
    case ESP_RST_TASK_WDT:
    case ESP_RST_INT_WDT:
    case ESP_RST_WDT:
        return HG_RESET_WATCHDOG;
    case ESP_RST_UNKNOWN:
        return HG_RESET_UNKNOWN;
    default:
        return HG_RESET_RESET;
    }
}

static void open_store(void)
{
    const esp_err_t found = nvs_flash_init();
    if (found == ESP_ERR_NVS_NO_FREE_PAGES || found == ESP_ERR_NVS_NEW_VERSION_FOUND) {
        ESP_ERROR_CHECK(nvs_flash_erase());
        ESP_ERROR_CHECK(nvs_flash_init());
    }
}

static void open_line(void)
{
    const uart_config_t settings = {
        .baud_rate = BAUD,
        .data_bits = UART_DATA_8_BITS,
        .parity = UART_PARITY_DISABLE,
        .stop_bits = UART_STOP_BITS_1,
        .flow_ctrl = UART_HW_FLOWCTRL_DISABLE,
    };
    ESP_ERROR_CHECK(uart_driver_install(LINE, LINE_BUFFER, LINE_BUFFER, 0, 0, 0));
    ESP_ERROR_CHECK(uart_param_config(LINE, &settings));
}

static void boot_up(void)
{
    hg_hardware hardware = {
        .capabilities = HG_CAN_SEED11 | HG_CAN_CODE | HG_CAN_UART | HG_CAN_PACKET | HG_CAN_POWER | HG_CAN_SAVE,
        .rate_least = RATE_LEAST,
        .rate_most = RATE_MOST,
        .ticks_per_s = RMT_TICKS_PER_S,
        .port = CONFIG_IDF_TARGET,
    };
    const hg_port port = {.context = 0, .write = write_line, .save = save, .load = load};
    ESP_ERROR_CHECK(esp_efuse_mac_get_default(hardware.uid + 2));
    const uint16_t boot = (uint16_t)(esp_random() & 0xFFFFu);
    hg_beacon_init(&beacon, &hardware, &port, boot == 0u ? 1u : boot, reset_reason(), now_ms());
}

void app_main(void)
{
    uint8_t bytes[64];
    open_store();
    open_line();
    boot_up();
    if (!rmt_light_open(&beacon.pump, CONFIG_HELIOGRAPH_LED_GPIO)) {
        esp_restart();
    }
    ESP_ERROR_CHECK(esp_task_wdt_add(0));
    for (;;) {
        ESP_ERROR_CHECK(esp_task_wdt_reset());
        /* A millisecond at most: a tick of FreeRTOS (sdkconfig.defaults). */
        const int n = uart_read_bytes(LINE, bytes, sizeof bytes, 1);
        hg_beacon_receive(&beacon, bytes, n > 0 ? (size_t)n : 0u, now_ms());
        hg_beacon_poll(&beacon, now_ms());
        if (!rmt_light_follow(hg_beacon_is_armed(&beacon))) {
            esp_restart(); /* dark, and the host is told by another BOOT */
        }
    }
}
