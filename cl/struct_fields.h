/* The layout of structs as the compiler has it, for the host to compare with its own field by field
 * (clvol/opencl/struct_check.py).
 *
 * A header that declares a struct names its fields in a list, STRUCT(Name), FIELD(Name, field), ..., and a program
 * with the kernel
 *
 *   #define REPORTED_FIELDS NAME_FIELDS, OTHER_FIELDS
 *   REPORT_FIELDS
 *
 * writes these records. A field that is in only one of the struct, the list and the host's dtype is found too: by its
 * name, or by the struct's size.
 */
#ifndef STRUCT_FIELDS_H
#define STRUCT_FIELDS_H

typedef struct {
  char name[56]; /* "Struct.field"; "Struct" for the whole */
  uint offset, bytes;
} StructField;

#define STRUCT(type) {#type, 0u, (uint)sizeof(type)}
#define FIELD(type, field) {#type "." #field, (uint)__builtin_offsetof(type, field), (uint)sizeof(((type *)0)->field)}

/* fields  StructField [capacity]; what is not written stays as it is */
#define REPORT_FIELDS                                                                           \
  __constant StructField reported_fields[] = {REPORTED_FIELDS};                                 \
  __kernel void struct_fields(__global uchar *fields, int capacity)                             \
  {                                                                                             \
    const int bytes = min((int)sizeof(reported_fields), capacity * (int)sizeof(StructField));   \
    for (int k = 0; k < bytes; ++k) fields[k] = ((__constant const uchar *)reported_fields)[k]; \
  }

#endif
