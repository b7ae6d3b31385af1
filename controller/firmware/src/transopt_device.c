#include "transopt_device.h"

size_t transopt_device_bytes(void)
{
    return sizeof(td_device);
}
